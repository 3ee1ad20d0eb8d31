"""What can be wrong before a load begins, and with what was asked for afterwards."""


class LoadTestError(Exception):
    """What is wrong, as one sentence that names the value."""


class BadTarget(LoadTestError):
    """The URL cannot be one, cannot be reached, or is not this machine's."""


class BadOption(LoadTestError):
    """An option is out of its range."""


class BadResult(LoadTestError):
    """A file is no result of this version."""


class BadBudget(LoadTestError):
    """A budget cannot be read."""
