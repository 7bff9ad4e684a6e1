"""The one exception for bad input: a single clear line that names the file, the field and what was expected."""


class SonarjaxError(ValueError):
    """Input or output that cannot be used. The message is a single line that can be shown to a user."""


class OutOfViewError(SonarjaxError):
    """An object lies where the sonar does not see it. A search goes on at other distances."""


class UnreadableError(SonarjaxError):
    """A frame that cannot be read. A command that goes on without it, or tells it from wrong options, exits with 1."""
