"""The one exception that bad input raises: a single clear line naming the file, the field and what was expected."""


class SonarjaxError(ValueError):
    """Input or output that cannot be used; the message is one line and fit to show to a user."""
