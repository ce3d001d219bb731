"""The checks of ``slipstitch doctor``: each looks at one thing and says how to get it."""

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

ROOT = Path(__file__).resolve().parents[3]
REQUIREMENTS = ROOT / "envs" / "requirements.txt"
SYSTEM_PACKAGES = ROOT / "envs" / "system-packages.txt"
DISK_NEEDED_BYTES = 2e9
MEMORY_NEEDED_BYTES = 4e9


class CheckState(enum.Enum):
    """How a finding stands: needed and there, worth knowing, needed and not there."""

    GOOD = "ok"
    NOTE = "note"
    MISSING = "MISSING"


@dataclass(frozen=True)
class Check:
    """One line of the screen."""

    name: str
    state: CheckState
    found: str
    remedy: str = ""


def examine() -> list[Check]:
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


def check_python() -> Check:
    """Python 3.11, the only one that bpy 4.5 is built for."""
    found = f"{platform.python_version()} in {sys.prefix}"
    if sys.version_info[:2] == (3, 11):
        return Check("Python", CheckState.GOOD, found)
    return Check("Python", CheckState.MISSING, found, "make setup PYTHON=/path/to/python3.11")


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


def check_packages(path: Path = REQUIREMENTS) -> Check:
    """The direct dependencies, at their pinned versions."""
    pinned = pinned_versions(path)
    if not pinned:
        return Check("packages", CheckState.NOTE, "no list of pinned versions beside the package")
    absent, other = compare_versions(pinned)
    wrong = [f"{package} (needs {version})" for package, version in absent.items()]
    wrong += [f"{package} {other[package]} (pinned {pinned[package]})" for package in other]
    if not wrong:
        return Check("packages", CheckState.GOOD, f"all {len(pinned)} at their pinned versions")
    good = len(pinned) - len(wrong)
    state = CheckState.MISSING if absent else CheckState.NOTE
    return Check("packages", state, f"{good} of {len(pinned)}; not: {', '.join(wrong)}",
                   "make setup")  # fmt: skip


def _package_folder(name: str) -> Path | None:
    specification = importlib.util.find_spec(name)
    if specification is None or specification.origin is None:
        return None
    return Path(specification.origin).parent


def check_system_libraries() -> Check:
    """The libraries of the system that Blender's module is linked against."""
    name = "system libraries"
    folder = _package_folder("bpy")
    if folder is None:
        return Check(name, CheckState.NOTE, "not checked: bpy is missing")
    if shutil.which("ldd") is None:
        return Check(name, CheckState.NOTE, "not checked: ldd is missing")
    answers = [
        subprocess.run(["ldd", str(module)], capture_output=True, text=True).stdout
        for module in sorted(folder.glob("*.so"))
    ]
    missing = sorted(set(re.findall(r"(\S+) => not found", "\n".join(answers))))
    if not missing:
        return Check(name, CheckState.GOOD, "all that Blender is linked against")
    packages = ""
    if SYSTEM_PACKAGES.is_file():
        lines = SYSTEM_PACKAGES.read_text(encoding="utf-8").splitlines()
        packages = " ".join(line for line in lines if not line.startswith("#"))
    return Check(name, CheckState.MISSING, ", ".join(missing), f"sudo apt-get install {packages}")


def _in_a_process(*arguments: str, seconds: float = 120.0) -> tuple[bool, str]:
    """Run a Python of its own with `arguments`; whether it ended well, and its last line."""
    try:
        answer = subprocess.run(
            [sys.executable, *arguments], capture_output=True, text=True, timeout=seconds
        )
    except subprocess.TimeoutExpired:
        return False, f"no answer in {seconds:g} s"
    lines = (answer.stdout if answer.returncode == 0 else answer.stderr).strip().splitlines()
    fallback = f"exit code {answer.returncode}"
    return answer.returncode == 0, lines[-1] if lines else fallback


def check_blender() -> Check:
    """Whether Blender's module can be imported, in a process of its own: it may crash one."""
    good, line = _in_a_process("-c", "import bpy; print(bpy.app.version_string)")
    if good:
        return Check("Blender", CheckState.GOOD, f"{line}, imports")
    return Check("Blender", CheckState.MISSING, f"import bpy: {line}", "make setup")


def check_warp() -> Check:
    """Whether Warp compiles and runs a kernel on the CPU."""
    good, line = _in_a_process("-m", "slipstitch.doctor.warp_kernel")
    if good:
        return Check("Warp", CheckState.GOOD, f"{line}, computes on the CPU")
    return Check("Warp", CheckState.MISSING, line, "make setup")


def check_processor(information: Path = Path("/proc/cpuinfo")) -> Check:
    """Cores, and the instructions that training in bfloat16 is fast with."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    flags: set[str] = set()
    if information.is_file():
        match = re.search(r"^flags\s*:(.*)$", information.read_text(encoding="utf-8"), re.MULTILINE)
        flags = set(match.group(1).split()) if match else set()
    features = [flag for flag in ("avx2", "avx512f", "avx512_bf16", "amx_bf16") if flag in flags]
    fast = bool({"avx512_bf16", "amx_bf16"} & flags)
    training = "bfloat16 training" if fast else "float32 training, 3-4 times slower than bfloat16"
    found = f"{cores} cores, {' '.join(features) or 'no vector extensions seen'}: {training}"
    return Check("processor", CheckState.GOOD if fast else CheckState.NOTE, found)


def check_gpu() -> Check:
    """A graphics processor; nothing needs one."""
    if shutil.which("nvidia-smi") is None:
        return Check("GPU", CheckState.NOTE, "none; not needed")
    answer = subprocess.run(
        ["nvidia-smi", "--query-gpu=name,memory.total", "--format=csv,noheader"],
        capture_output=True,
        text=True,
    )
    names = "; ".join(answer.stdout.strip().splitlines())
    if answer.returncode != 0 or not names:
        return Check("GPU", CheckState.NOTE, "none that works; not needed")
    return Check("GPU", CheckState.GOOD, names)


def _size(size_bytes: float) -> str:
    return f"{size_bytes / 1e9:.1f} GB"


def check_memory() -> Check:
    """Main memory for two jobs at a time."""
    try:
        total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (ValueError, OSError):
        return Check("memory", CheckState.NOTE, "unknown")
    if total < MEMORY_NEEDED_BYTES:
        remedy = "run one job at a time: make all CORES=1"
        return Check("memory", CheckState.NOTE, f"{_size(total)}, little for two jobs", remedy)
    return Check("memory", CheckState.GOOD, _size(total))


def check_disk(folder: Path | None = None, needed_bytes: float = DISK_NEEDED_BYTES) -> Check:
    """Free space where the results go: the working folder."""
    free = shutil.disk_usage(folder or Path.cwd()).free
    if free < needed_bytes:
        remedy = f"free {_size(needed_bytes)}, or use snakemake --directory on another disk"
        return Check("free disk", CheckState.MISSING, f"{_size(free)} here", remedy)
    return Check("free disk", CheckState.GOOD, f"{_size(free)} here")


def check_git() -> Check:
    """git, for the commit in the provenance records."""
    if shutil.which("git"):
        return Check("git", CheckState.GOOD, "there")
    return Check("git", CheckState.NOTE, "none: provenance records go without a commit",
                   "sudo apt-get install git")  # fmt: skip
