"""Limits of time that count the processor's seconds, of which a busy machine takes no more."""

import resource


def limited(process, seconds):
    """A process that was just begun, which is ended when it has worked for so long.

    What waits for nothing is not: it does not work. (Where there is no `prlimit`, nothing is.)
    """
    if hasattr(resource, "prlimit"):
        resource.prlimit(process.pid, resource.RLIMIT_CPU, (seconds, seconds))
    return process
