"""Host settings for a process that must wake up on time."""

import os
import platform
from pathlib import Path
from typing import NamedTuple

_UNLIMITED = "unlimited"


class _HostSetting(NamedTuple):
    """One setting of the host."""

    name: str
    value: str
    advice: str  # what to do about it; empty when nothing


def host_settings() -> list[_HostSetting]:
    """Settings that matter for a cycle at wall-clock pace; unreadable ones are left out."""
    settings = [
        _HostSetting("kernel", f"{platform.system()} {platform.release()}", _kernel_advice()),
        _HostSetting("processors", str(len(_affinity())), _processor_advice()),
        _limit("real-time priority", "RLIMIT_RTPRIO", "rtprio"),
        _limit("locked memory", "RLIMIT_MEMLOCK", "memlock"),
    ]
    runtime = _read("/proc/sys/kernel/sched_rt_runtime_us")
    if runtime:
        settings.append(
            _HostSetting("real-time share", "all" if runtime == "-1" else f"{runtime} us of each second", "")
        )
    governor = _read("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor")
    if governor:
        advice = "" if governor == "performance" else "cpupower frequency-set -g performance keeps the clock up"
        settings.append(_HostSetting("frequency governor", governor, advice))
    source = _read("/sys/devices/system/clocksource/clocksource0/current_clocksource")
    if source:
        settings.append(_HostSetting("clock source", source, "" if source != "jiffies" else "too coarse for a cycle"))
    return settings


def _affinity() -> set[int]:
    return os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set(range(os.cpu_count() or 1))


def _kernel_advice() -> str:
    return "" if _read("/sys/kernel/realtime") == "1" else "no PREEMPT_RT: wake-ups may be late by milliseconds"


def _processor_advice() -> str:
    return "" if len(_affinity()) > 1 else "the log writer shares the only processor with the cycle"


def _limit(name: str, key: str, item: str) -> _HostSetting:
    try:
        import resource
    except ImportError:  # Windows
        return _HostSetting(name, "not on this system", "")
    number = getattr(resource, key, None)  # Linux alone
    if number is None:
        return _HostSetting(name, "not on this system", "")
    soft, _ = resource.getrlimit(number)
    granted = soft == resource.RLIM_INFINITY or soft > 0
    advice = "" if granted else f"not permitted; grant `{item}` in /etc/security/limits.conf"
    return _HostSetting(name, _UNLIMITED if soft == resource.RLIM_INFINITY else str(soft), advice)


def _read(path: str) -> str:
    try:
        return Path(path).read_text(encoding="ascii", errors="replace").strip()
    except OSError:
        return ""
