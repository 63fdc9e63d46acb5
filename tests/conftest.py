from hypothesis import settings

# Machines that run tests are busy, so no example has a deadline; and the same code always passes
# or always fails.
settings.register_profile("rollcast", deadline=None, derandomize=True, max_examples=50)
settings.load_profile("rollcast")
