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


@pytest.fixture(scope="session")
def scene_file(tmp_path_factory):
    """Four frames of ``command_line.make_scene`` in one .svgf file."""
    from dataclasses import replace

    import svgf

    from .command_line import make_scene

    path = tmp_path_factory.mktemp("scenes") / "shard.svgf"
    meshes = make_scene().meshes
    svgf.save(path, (replace(make_scene(frame), meshes=meshes) for frame in range(1, 5)))
    return path
