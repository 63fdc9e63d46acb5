"""The commands of ``rollcast``, one a file; ``rollcast/__main__.py`` puts them together."""
