"""Build wheels that bring compiled kernels, see `async_tnt/kernels/shipped.py`.

Two variables of the environment decide what a wheel brings:

    ASYNC_TNT_COMPILE    host: code for this machine's processor (by default)
                         all: code for all kinds of processors that this system may run on
                         none: no code; the wheel fits every system, and compiles at first use
    ASYNC_TNT_PLATFORM   the platform in the wheel's name, such as manylinux_2_28_x86_64; by default
                         this system's
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

CHOICES = ("host", "all", "none")
FOLDER = "async_tnt/kernels/compiled"
"""Where the code lies in the wheel."""


class CompiledKernels(BuildHookInterface):
    """Compiles the kernels before a wheel is put together."""

    PLUGIN_NAME = "custom"
    _folder: str | None = None

    def dependencies(self) -> list[str]:
        """What the build needs besides `hatchling`."""
        if _choice() == "none":
            return []
        if _choice() == "all":
            return list(self.config["released-with"])
        # the newest, as the installation itself will take
        return [name for name in self.metadata.core.dependencies if name.startswith("numba")]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile, and give the wheel the name of what it fits."""
        # An editable installation uses the checkout, whose kernels are edited.
        if version == "editable" or _choice() == "none":
            return
        self._folder = tempfile.mkdtemp()
        words = ["all"] if _choice() == "all" else []
        command = [sys.executable, "-m", "async_tnt.kernels.ship", self._folder, *words]
        # pip passes what the build needs through this variable
        paths = os.pathsep.join([self.root, os.environ.get("PYTHONPATH", "")])
        done = subprocess.run(command, env=os.environ | {"PYTHONPATH": paths})
        if done.returncode:
            self.app.display_warning("the kernels are not compiled: they will be at first use")
            return
        for path in Path(self._folder).glob("*.code"):
            build_data["force_include"][str(path)] = f"{FOLDER}/{path.name}"
        build_data["pure_python"] = False
        build_data["tag"] = f"{_python()}-{_platform()}"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove what lies in the wheel now."""
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)


def _choice() -> str:
    choice = os.environ.get("ASYNC_TNT_COMPILE", "host")
    if choice not in CHOICES:
        raise ValueError(f"ASYNC_TNT_COMPILE must be one of {', '.join(CHOICES)}, got {choice}")
    return choice


def _python() -> str:
    """The tags of this interpreter and its ABI, such as cp311-cp311."""
    name = f"cp{sys.version_info.major}{sys.version_info.minor}"
    threads = "t" if sysconfig.get_config_var("Py_GIL_DISABLED") else ""
    return f"{name}-{name}{threads}"


def _platform() -> str:
    named = os.environ.get("ASYNC_TNT_PLATFORM", sysconfig.get_platform())
    return named.replace("-", "_").replace(".", "_")
