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


def check_python() -> Diagnosis:
    """Python 3.11, the only one that bpy 4.5 is built for."""
    found = f"{platform.python_version()} in {sys.prefix}"
    if sys.version_info[:2] == (3, 11):
        return Diagnosis("Python", Standing.GOOD, found)
    return Diagnosis("Python", Standing.MISSING, found, "make setup PYTHON=/path/to/python3.11")


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
        return Diagnosis("packages", Standing.NOTE, "no list of pinned versions found")
    absent, other = compare_versions(pinned)
    wrong = [f"{package} (needs {version})" for package, version in absent.items()]
    wrong += [f"{package} {other[package]} (pinned {pinned[package]})" for package in other]
    if not wrong:
        return Diagnosis("packages", Standing.GOOD, f"all {len(pinned)} at their pinned versions")
    good = len(pinned) - len(wrong)
    state = Standing.MISSING if absent else Standing.NOTE
    return Diagnosis("packages", state, f"{good} of {len(pinned)} at their pinned versions; not: "
    f"{', '.join(wrong)}",
                   "make setup")  # fmt: skip


def _package_folder(name: str) -> Path | None:
    specification = importlib.util.find_spec(name)
    if specification is None or specification.origin is None:
        return None
    return Path(specification.origin).parent


def check_system_libraries() -> Diagnosis:
    """The libraries of the system that Blender's module is linked against."""
    name = "system libraries"
    folder = _package_folder("bpy")
    if folder is None:
        return Diagnosis(name, Standing.NOTE, "not checked: bpy is missing")
    if shutil.which("ldd") is None:
        return Diagnosis(name, Standing.NOTE, "not checked: ldd is missing")
    answers = [
        subprocess.run(["ldd", str(module)], capture_output=True, text=True).stdout
        for module in sorted(folder.glob("*.so"))
    ]
    missing = sorted(set(re.findall(r"(\S+) => not found", "\n".join(answers))))
    if not missing:
        return Diagnosis(name, Standing.GOOD, "all libraries that Blender requires")
    packages = ""
    if SYSTEM_PACKAGES.is_file():
        lines = SYSTEM_PACKAGES.read_text(encoding="utf-8").splitlines()
        packages = " ".join(line for line in lines if not line.startswith("#"))
    return Diagnosis(name, Standing.MISSING, ", ".join(missing), f"sudo apt-get install {packages}")


def _in_a_process(*arguments: str, seconds: float = 120.0) -> tuple[bool, str]:
    """Run a Python of its own with `arguments`; whether it ended well, and its last line."""
    try:
        answer = subprocess.run(
            [sys.executable, *arguments], capture_output=True, text=True, timeout=seconds
        )
    except subprocess.TimeoutExpired:
        return False, f"no answer within {seconds:g} s"
    lines = (answer.stdout if answer.returncode == 0 else answer.stderr).strip().splitlines()
    fallback = f"exit code {answer.returncode}"
    return answer.returncode == 0, lines[-1] if lines else fallback


def check_blender() -> Diagnosis:
    """Whether Blender's module can be imported, in a process of its own: it may crash one."""
    good, line = _in_a_process("-c", "import bpy; print(bpy.app.version_string)")
    if good:
        return Diagnosis("Blender", Standing.GOOD, f"{line}, imports")
    return Diagnosis("Blender", Standing.MISSING, f"import bpy: {line}", "make setup")


def check_warp() -> Diagnosis:
    """Whether Warp compiles and runs a kernel on the CPU."""
    good, line = _in_a_process("-m", "slipstitch.report.warp_kernel")
    if good:
        return Diagnosis("Warp", Standing.GOOD, f"{line}, runs on the CPU")
    return Diagnosis("Warp", Standing.MISSING, line, "make setup")


def check_processor(information: Path = Path("/proc/cpuinfo")) -> Diagnosis:
    """Cores, and the instructions that training in bfloat16 is fast with."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    flags: set[str] = set()
    if information.is_file():
        match = re.search(r"^flags\s*:(.*)$", information.read_text(encoding="utf-8"), re.MULTILINE)
        flags = set(match.group(1).split()) if match else set()
    features = [flag for flag in ("avx2", "avx512f", "avx512_bf16", "amx_bf16") if flag in flags]
    fast = bool({"avx512_bf16", "amx_bf16"} & flags)
    training = "bfloat16 training" if fast else "float32 training, 3-4 times slower than bfloat16"
    found = f"{cores} cores, {' '.join(features) or 'no vector extensions found'}: {training}"
    return Diagnosis("processor", Standing.GOOD if fast else Standing.NOTE, found)


def check_gpu() -> Diagnosis:
    """A graphics processor; nothing needs one."""
    if shutil.which("nvidia-smi") is None:
        return Diagnosis("GPU", Standing.NOTE, "none; not required")
    answer = subprocess.run(
        ["nvidia-smi", "--query-gpu=name,memory.total", "--format=csv,noheader"],
        capture_output=True,
        text=True,
    )
    names = "; ".join(answer.stdout.strip().splitlines())
    if answer.returncode != 0 or not names:
        return Diagnosis("GPU", Standing.NOTE, "none usable; not required")
    return Diagnosis("GPU", Standing.GOOD, names)


def _size(size_bytes: float) -> str:
    return f"{size_bytes / 1e9:.1f} GB"


def check_memory() -> Diagnosis:
    """Main memory for two jobs at a time."""
    try:
        total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (ValueError, OSError):
        return Diagnosis("memory", Standing.NOTE, "unknown")
    if total < MEMORY_NEEDED_BYTES:
        remedy = "run one job at a time: make all CORES=1"
        return Diagnosis(
            "memory", Standing.NOTE, f"{_size(total)}, not enough for two jobs", remedy
        )
    return Diagnosis("memory", Standing.GOOD, _size(total))


def check_disk(folder: Path | None = None, needed_bytes: float = DISK_NEEDED_BYTES) -> Diagnosis:
    """Free space where the results go: the working folder."""
    free = shutil.disk_usage(folder or Path.cwd()).free
    if free < needed_bytes:
        remedy = f"free {_size(needed_bytes)}, or use snakemake --directory on another disk"
        return Diagnosis("free disk", Standing.MISSING, f"{_size(free)} here", remedy)
    return Diagnosis("free disk", Standing.GOOD, f"{_size(free)} here")


def check_git() -> Diagnosis:
    """git, for the commit in the provenance records."""
    if shutil.which("git"):
        return Diagnosis("git", Standing.GOOD, "there")
    return Diagnosis("git", Standing.NOTE, "none: provenance records will not contain a commit",
                   "sudo apt-get install git")  # fmt: skip
