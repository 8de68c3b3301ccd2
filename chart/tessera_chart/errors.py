"""What ends a run with one line instead of a traceback."""


class BadInput(Exception):
    """A flag, a file or a scene is wrong; the message names it and the remedy. Exit code 2."""
