"""The archive of the extension, which several modules use."""

import pytest

import make_archive


@pytest.fixture(scope="session")
def archive(tmp_path_factory):
    path = tmp_path_factory.mktemp("extension") / "lumitree-blender.zip"
    path.write_bytes(make_archive.archive())
    return path
