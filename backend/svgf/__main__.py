# SPDX-License-Identifier: Apache-2.0
"""``python -m svgf`` is the command ``svgf``."""

from .cli import main

main()
