"""The archive of the extension for Blender, which several modules use."""

import pytest

import lumitree


@pytest.fixture(scope="session")
def archive(tmp_path_factory, mi):
    path = tmp_path_factory.mktemp("extension") / "lumitree-blender.zip"
    lumitree.blender_extension(path)
    return path
