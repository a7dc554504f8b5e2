"""The one exception that means: the user can mend this."""


class LightdomeError(Exception):
    """A mistake in the input or the machine, told in one line that says what to do.

    Scripts print it without a traceback and exit with status 1. Everything else that is
    raised is a defect of lightdome and keeps its traceback.
    """
