# SPDX-License-Identifier: Apache-2.0
"""Fixtures. A test that takes ``device`` runs once on every device of this machine."""

from __future__ import annotations

import pytest


def _devices() -> list:
    from svgf.devices import available_devices

    marks = {"cuda": [pytest.mark.gpu]}
    return [
        pytest.param(info.name, marks=[*marks.get(info.name, []), *([] if info.available else [_skip(info)])])
        for info in sorted(available_devices(), key=lambda info: info.name, reverse=True)
    ]


def _skip(info) -> pytest.MarkDecorator:
    return pytest.mark.skip(reason=f'device "{info.name}" is not available: {info.reason}')


def pytest_generate_tests(metafunc) -> None:
    if "device" in metafunc.fixturenames:
        metafunc.parametrize("device", _devices(), indirect=True)


@pytest.fixture
def device(request):
    """An opened svgf device."""
    from svgf.devices import open_device

    return open_device(request.param)
