"""The checks of ``slipstitch doctor``: each checks one requirement and names its remedy."""

import enum
import importlib.metadata
import importlib.util
import os
import platform
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from slipstitch.base.page.wording import size
from slipstitch.base.project import project_folder

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


@dataclass(frozen=True)
class Diagnosis:
    """One line of the screen."""

    name: str
    state: Standing
    found: str
    remedy: str = ""


def examine() -> list[Diagnosis]:
    """All checks, in the order they are shown."""
    return [
        check_python(),
        check_packages(),
        check_system_libraries(),
        check_blender(),
        check_warp(),
        check_processor(),
        check_gpu(),
        check_memory(),
        check_disk(),
        check_git(),
    ]


def print_findings() -> int:
    """Print all findings with their remedies; return 1 if a requirement is missing."""
    findings = examine()
    width = max(len(finding.name) for finding in findings)
    for finding in findings:
        print(f"{finding.state.value:<7} {finding.name:<{width}}  {finding.found}")
    remedies = [f"{finding.name}: {finding.remedy}" for finding in findings if finding.remedy]
    if remedies:
        print("", *remedies, sep="\n")
    missing = [finding.name for finding in findings if finding.state is Standing.MISSING]
    print()
    if missing:
        print(f"Slipstitch cannot run everything; missing: {', '.join(missing)} (see above).")
    else:
        print("All requirements of Slipstitch are met.")
    return 1 if missing else 0


def _good(name: str, found: str) -> Diagnosis:
    return Diagnosis(name, Standing.GOOD, found)


def _note(name: str, found: str, remedy: str = "") -> Diagnosis:
    return Diagnosis(name, Standing.NOTE, found, remedy)


def _missing(name: str, found: str, remedy: str) -> Diagnosis:
    return Diagnosis(name, Standing.MISSING, found, remedy)


def check_python() -> Diagnosis:
    """Python 3.11, the only one that bpy 4.5 is built for."""
    found = f"{platform.python_version()} in {sys.prefix}"
    if sys.version_info[:2] == (3, 11):
        return _good("Python", found)
    return _missing("Python", found, "make setup PYTHON=/path/to/python3.11")


def pinned_versions(path: Path = REQUIREMENTS) -> dict[str, str]:
    """Package -> version of a requirements file; empty if there is no such file."""
    if not path.is_file():
        return {}
    lines = (line.split("#")[0].strip() for line in path.read_text(encoding="utf-8").splitlines())
    return dict(line.split("==") for line in lines if "==" in line)


def compare_versions(pinned: dict[str, str]) -> tuple[dict[str, str], dict[str, str]]:
    """Pinned packages that are absent, and those of another version with the one installed.

    The local part of a version (``+cpu``) does not count.
    """
    absent, other = {}, {}
    for package, version in pinned.items():
        try:
            installed = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            absent[package] = version
        else:
            if installed.split("+")[0] != version:
                other[package] = installed
    return absent, other


def check_packages(path: Path = REQUIREMENTS) -> Diagnosis:
    """The direct dependencies, at their pinned versions."""
    pinned = pinned_versions(path)
    if not pinned:
        return _note("packages", "no list of pinned versions found")
    absent, other = compare_versions(pinned)
    wrong = [f"{package} (needs {version})" for package, version in absent.items()]
    wrong += [f"{package} {other[package]} (pinned {pinned[package]})" for package in other]
    if not wrong:
        return _good("packages", f"all {len(pinned)} at their pinned versions")
    found = f"{len(pinned) - len(wrong)} of {len(pinned)} at their pinned versions; not: "
    return (_missing if absent else _note)("packages", found + ", ".join(wrong), "make setup")


def check_system_libraries() -> Diagnosis:
    """The libraries of the system that Blender's module is linked against."""
    name, bpy = "system libraries", importlib.util.find_spec("bpy")
    if bpy is None or bpy.origin is None:
        return _note(name, "not checked: bpy is missing")
    if shutil.which("ldd") is None:
        return _note(name, "not checked: ldd is missing")
    answers = [
        subprocess.run(["ldd", str(module)], capture_output=True, text=True).stdout
        for module in sorted(Path(bpy.origin).parent.glob("*.so"))
    ]
    missing = sorted(set(re.findall(r"(\S+) => not found", "\n".join(answers))))
    if not missing:
        return _good(name, "all libraries that Blender requires")
    packages = ""
    if SYSTEM_PACKAGES.is_file():
        lines = SYSTEM_PACKAGES.read_text(encoding="utf-8").splitlines()
        packages = " ".join(line for line in lines if not line.startswith("#"))
    return _missing(name, ", ".join(missing), f"sudo apt-get install {packages}")


def _in_a_process(*arguments: str, seconds: float = 120.0) -> tuple[bool, str]:
    """Run a Python of its own with `arguments`; whether it ended well, and its last line."""
    try:
        answer = subprocess.run(
            [sys.executable, *arguments], capture_output=True, text=True, timeout=seconds
        )
    except subprocess.TimeoutExpired:
        return False, f"no answer within {seconds:g} s"
    lines = (answer.stdout if answer.returncode == 0 else answer.stderr).strip().splitlines()
    return answer.returncode == 0, lines[-1] if lines else f"exit code {answer.returncode}"


def check_blender() -> Diagnosis:
    """Whether Blender's module can be imported, in a process of its own: it may crash one."""
    good, line = _in_a_process("-c", "import bpy; print(bpy.app.version_string)")
    if good:
        return _good("Blender", f"{line}, imports")
    return _missing("Blender", f"import bpy: {line}", "make setup")


def check_warp() -> Diagnosis:
    """Whether Warp compiles and runs a kernel on the CPU."""
    good, line = _in_a_process("-m", "slipstitch.report.warp_kernel")
    if good:
        return _good("Warp", f"{line}, runs on the CPU")
    return _missing("Warp", line, "make setup")


def check_processor(information: Path = Path("/proc/cpuinfo")) -> Diagnosis:
    """Cores, and the instructions that training in bfloat16 is fast with."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    text = information.read_text(encoding="utf-8") if information.is_file() else ""
    match = re.search(r"^flags\s*:(.*)$", text, re.MULTILINE)
    flags = match.group(1).split() if match else []
    features = [flag for flag in ("avx2", "avx512f", "avx512_bf16", "amx_bf16") if flag in flags]
    found = f"{cores} cores, {' '.join(features) or 'no vector extensions found'}: "
    if {"avx512_bf16", "amx_bf16"}.isdisjoint(flags):
        return _note("processor", found + "float32 training, 3-4 times slower than bfloat16")
    return _good("processor", found + "bfloat16 training")


def check_gpu() -> Diagnosis:
    """A graphics processor; nothing needs one."""
    if shutil.which("nvidia-smi") is None:
        return _note("GPU", "none; not required")
    command = ["nvidia-smi", "--query-gpu=name,memory.total", "--format=csv,noheader"]
    answer = subprocess.run(command, capture_output=True, text=True)
    names = "; ".join(answer.stdout.strip().splitlines())
    if answer.returncode != 0 or not names:
        return _note("GPU", "none usable; not required")
    return _good("GPU", names)


def check_memory() -> Diagnosis:
    """Main memory for two jobs at a time."""
    try:
        total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (ValueError, OSError):
        return _note("memory", "unknown")
    if total < MEMORY_NEEDED_BYTES:
        remedy = "run one job at a time: make all CORES=1"
        return _note("memory", f"{size(total)}, not enough for two jobs", remedy)
    return _good("memory", size(total))


def check_disk(folder: Path | None = None, needed_bytes: float = DISK_NEEDED_BYTES) -> Diagnosis:
    """Free space where the results go: the working folder."""
    free = shutil.disk_usage(folder or Path.cwd()).free
    if free < needed_bytes:
        remedy = f"free {size(needed_bytes)}, or use snakemake --directory on another disk"
        return _missing("free disk", f"{size(free)} here", remedy)
    return _good("free disk", f"{size(free)} here")


def check_git() -> Diagnosis:
    """git, for the commit in the provenance records."""
    if shutil.which("git"):
        return _good("git", "there")
    found = "none: provenance records will not contain a commit"
    return _note("git", found, "sudo apt-get install git")
