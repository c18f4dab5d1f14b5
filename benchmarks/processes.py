"""What processes have used of the processor."""

import psutil


def processor_time_s(pid: int) -> float:
    """Return the processor time of a process, and of those that it started, ended or not; in steps of 10 ms."""
    process = psutil.Process(pid)
    ended = process.cpu_times()
    running = [each.cpu_times() for each in (process, *process.children(recursive=True))]
    return ended.children_user + ended.children_system + sum(each.user + each.system for each in running)
