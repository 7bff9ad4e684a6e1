"""The one exception for bad input: a single clear line that names the file, the field and what was expected."""


class SonarjaxError(ValueError):
    """Input or output that cannot be used. The message is a single line that can be shown to a user."""


class OutOfViewError(SonarjaxError):
    """An object lies where the sonar does not see it. A search goes on at other distances."""


class UnreadableError(SonarjaxError):
    """A frame that cannot be read: a command then exits with 1, not with 2 as for wrong options."""
