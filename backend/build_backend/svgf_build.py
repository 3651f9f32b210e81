# SPDX-License-Identifier: Apache-2.0
"""scikit-build-core, plus one decision: where the system has no CUDA compiler of its own, take NVIDIA's from PyPI.

SVGF_CUDA=off builds without CUDA.
"""

from __future__ import annotations

import os
import platform
import re
import shutil
import subprocess
import sys

from scikit_build_core import build as _build
from scikit_build_core.build import *  # noqa: F403  (the hooks that are not overridden below)

# One toolkit: their minor versions must be equal.
CUDA_PACKAGES = [
    f"{name}==13.0.*"
    for name in (
        "nvidia-cuda-nvcc",
        "nvidia-nvvm",
        "nvidia-cuda-crt",
        "nvidia-cuda-runtime",
        "nvidia-cuda-cccl",
    )
]


def _system_has_nvcc() -> bool:
    nvcc = shutil.which("nvcc") or shutil.which("nvcc", path="/usr/local/cuda/bin")
    if nvcc is None:
        return False
    text = subprocess.run([nvcc, "--version"], capture_output=True, text=True, check=False).stdout
    release = re.search(r"release (\d+)\.", text)
    return release is not None and int(release[1]) >= 13


def _cuda_packages() -> list[str]:
    published = sys.platform == "linux" and platform.machine() in ("x86_64", "aarch64")
    published = published or (sys.platform == "win32" and platform.machine() == "AMD64")
    wanted = os.environ.get("SVGF_CUDA", "auto") != "off"
    return CUDA_PACKAGES if published and wanted and not _system_has_nvcc() else []


def get_requires_for_build_wheel(config_settings=None):
    return _build.get_requires_for_build_wheel(config_settings) + _cuda_packages()


def get_requires_for_build_editable(config_settings=None):
    return _build.get_requires_for_build_editable(config_settings) + _cuda_packages()
