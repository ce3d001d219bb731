"""The checks of ``slipstitch doctor``: each checks one requirement and names its remedy."""

import enum
import importlib.util
import os
import platform
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

from slipstitch.base.page.wording import size
from slipstitch.base.project import installed_version, pinned_versions, project_folder

ENVIRONMENT = project_folder() / "envs"
REQUIREMENTS = ENVIRONMENT / "requirements.txt"
SYSTEM_PACKAGES = ENVIRONMENT / "system-packages.txt"
DISK_NEEDED_BYTES = 2e9
MEMORY_NEEDED_BYTES = 4e9


class Standing(enum.Enum):
    """State of a finding: requirement met, information, requirement missing."""

    GOOD = "ok"
    NOTE = "note"
    MISSING = "MISSING"


class Diagnosis(NamedTuple):
    """One line of the screen."""

    name: str
    state: Standing
    found: str
    remedy: str = ""


def print_findings() -> int:
    """Print all findings with their remedies; return 1 if a requirement is missing."""
    findings = examine()
    width = max(len(finding.name) for finding in findings)
    for finding in findings:
        print(f"{finding.state.value:<7} {finding.name:<{width}}  {finding.found}")
    if remedies := [f"{one.name}: {one.remedy}" for one in findings if one.remedy]:
        print("", *remedies, sep="\n")
    missing = ", ".join(one.name for one in findings if one.state is Standing.MISSING)
    lacking = f"Slipstitch cannot run everything; missing: {missing} (see above)."
    print(f"\n{lacking if missing else 'All requirements of Slipstitch are met.'}")
    return 1 if missing else 0


def _met(
    good: bool, name: str, found: str, remedy: str, else_: Standing = Standing.MISSING
) -> Diagnosis:
    """A requirement that is met, or missing with its remedy."""
    return Diagnosis(name, Standing.GOOD if good else else_, found, "" if good else remedy)


def _note(name: str, found: str) -> Diagnosis:
    return Diagnosis(name, Standing.NOTE, found)


def check_python() -> Diagnosis:
    """Python 3.11, the only one that bpy 4.5 is built for."""
    found = f"{platform.python_version()} in {sys.prefix}"
    remedy = "make setup PYTHON=/path/to/python3.11"
    return _met(sys.version_info[:2] == (3, 11), "Python", found, remedy)


def check_packages(path: Path = REQUIREMENTS) -> Diagnosis:
    """The direct dependencies at their pinned versions; only one that is absent is missing."""
    pinned = pinned_versions(path)
    if not pinned:
        return _note("packages", "no list of pinned versions found")
    installed = {package: installed_version(package) for package in pinned}
    absent = [f"{name} (needs {pinned[name]})" for name, there in installed.items() if not there]
    other = [
        f"{name} {there} (pinned {pinned[name]})"
        for name, there in installed.items()
        if there and there.partition("+")[0] != pinned[name]
    ]
    wrong = absent + other
    found = f"all {len(pinned)} at their pinned versions"
    if wrong:
        found = f"{len(pinned) - len(wrong)} of{found[3:]}; not: {', '.join(wrong)}"
    else_ = Standing.MISSING if absent else Standing.NOTE
    return _met(not wrong, "packages", found, "make setup", else_)


def check_system_libraries() -> Diagnosis:
    """The libraries of the system that Blender's module is linked against."""
    name, bpy = "system libraries", importlib.util.find_spec("bpy")
    if bpy is None or bpy.origin is None:
        return _note(name, "not checked: bpy is missing")
    if shutil.which("ldd") is None:
        return _note(name, "not checked: ldd is missing")
    modules = sorted(Path(bpy.origin).parent.glob("*.so"))
    runs = [subprocess.run(["ldd", str(one)], capture_output=True, text=True) for one in modules]
    linked = "\n".join(run.stdout for run in runs)
    missing = sorted(set(re.findall(r"(\S+) => not found", linked)))
    lines = SYSTEM_PACKAGES.read_text(encoding="utf-8") if SYSTEM_PACKAGES.is_file() else ""
    packages = " ".join(line for line in lines.splitlines() if not line.startswith("#"))
    found = ", ".join(missing) or "all libraries that Blender requires"
    return _met(not missing, name, found, f"sudo apt-get install {packages}")


def _in_a_process(*arguments: str, seconds: float = 120.0) -> tuple[bool, str]:
    """Run a Python of its own with `arguments`; whether it ended well, and its last line."""
    words = [sys.executable, *arguments]
    try:
        answer = subprocess.run(words, capture_output=True, text=True, timeout=seconds)
    except subprocess.TimeoutExpired:
        return False, f"no answer within {seconds:g} s"
    lines = (answer.stdout if answer.returncode == 0 else answer.stderr).strip().splitlines()
    return answer.returncode == 0, lines[-1] if lines else f"exit code {answer.returncode}"


def check_blender() -> Diagnosis:
    """Whether Blender's module can be imported, in a process of its own: it may crash one."""
    good, line = _in_a_process("-c", "import bpy; print(bpy.app.version_string)")
    found = f"{line}, imports" if good else f"import bpy: {line}"
    return _met(good, "Blender", found, "make setup")


def check_warp() -> Diagnosis:
    """Whether Warp compiles and runs a kernel on the CPU."""
    good, line = _in_a_process("-m", __name__)
    return _met(good, "Warp", f"{line}, runs on the CPU" if good else line, "make setup")


def check_processor(information: Path = Path("/proc/cpuinfo")) -> Diagnosis:
    """Cores, and the instructions that training in bfloat16 is fast with."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    text = information.read_text(encoding="utf-8") if information.is_file() else ""
    match = re.search(r"^flags\s*:(.*)$", text, re.MULTILINE)
    flags = match[1].split() if match else []
    features = [flag for flag in ("avx2", "avx512f", "avx512_bf16", "amx_bf16") if flag in flags]
    fast = not {"avx512_bf16", "amx_bf16"}.isdisjoint(flags)
    found = f"{cores} cores, {' '.join(features) or 'no vector extensions found'}: "
    found += "bfloat16 training" if fast else "float32 training, 3-4 times slower than bfloat16"
    return _met(fast, "processor", found, "", Standing.NOTE)


def check_gpu() -> Diagnosis:
    """A graphics processor; nothing needs one."""
    if shutil.which("nvidia-smi") is None:
        return _note("GPU", "none; not required")
    command = ["nvidia-smi", "--query-gpu=name,memory.total", "--format=csv,noheader"]
    answer = subprocess.run(command, capture_output=True, text=True)
    names = "; ".join(answer.stdout.strip().splitlines()) if answer.returncode == 0 else ""
    return _met(bool(names), "GPU", names or "none usable; not required", "", Standing.NOTE)


def check_memory() -> Diagnosis:
    """Main memory for two jobs at a time."""
    try:
        total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (ValueError, OSError):
        return _note("memory", "unknown")
    enough = total >= MEMORY_NEEDED_BYTES
    found = size(total) + ("" if enough else ", not enough for two jobs")
    return _met(enough, "memory", found, "run one job at a time: make all CORES=1", Standing.NOTE)


def check_disk(folder: Path | None = None, needed_bytes: float = DISK_NEEDED_BYTES) -> Diagnosis:
    """Free space where the results go: the working folder."""
    free = shutil.disk_usage(folder or Path.cwd()).free
    remedy = f"free {size(needed_bytes)}, or use snakemake --directory on another disk"
    return _met(free >= needed_bytes, "free disk", f"{size(free)} here", remedy)


def check_git() -> Diagnosis:
    """git, for the commit in the provenance records."""
    there = shutil.which("git") is not None
    found = "there" if there else "none: provenance records will not contain a commit"
    return _met(there, "git", found, "sudo apt-get install git", Standing.NOTE)


def examine() -> list[Diagnosis]:
    """All checks, in the order they are shown."""
    first = check_python, check_packages, check_system_libraries, check_blender, check_warp
    then = check_processor, check_gpu, check_memory, check_disk, check_git
    return [check() for check in (*first, *then)]


def run_a_kernel() -> None:
    """Compile and run a Warp kernel on the CPU; print Warp's version."""
    import warp as wp

    from slipstitch.base.start import start_warp

    @wp.kernel
    def double(values: wp.array(dtype=wp.float64)):
        i = wp.tid()
        values[i] = wp.float64(2.0) * values[i]

    start_warp()
    array = wp.full(3, 2.0, dtype=wp.float64, device="cpu")
    wp.launch(double, dim=3, inputs=[array], device="cpu")
    if not (array.numpy() == 4.0).all():
        raise SystemExit("a kernel gives wrong results")
    print(wp.config.version)


if __name__ == "__main__":
    run_a_kernel()
