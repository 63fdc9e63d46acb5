"""``python -m training``: simulate, train, evaluate, export."""

from training.cli import application

app = application()

if __name__ == "__main__":
    app()
