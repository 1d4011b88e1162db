"""The wheel and the source distribution: what is in them, and that an installation of them works.

`LUMITREE_DISTRIBUTIONS` names a folder that has both (`make dist`); otherwise they are built here,
without a network, by what the extra `dev` installs.
"""

import dataclasses
import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from email.parser import BytesParser
from pathlib import Path

import pytest

from lumitree import __version__

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "lumitree"
# Files of the source distribution beside the package; setuptools adds two of them.
BESIDE = {
    *("CHANGELOG.md", "CITATION.cff", "CONTRIBUTING.md", "LICENSE", "MANIFEST.in", "README.md"),
    *("SECURITY.md", "constraints.txt", "pyproject.toml", "setup.cfg", "PKG-INFO"),
}
FOLDER = "Ordner für Leuchten (灯)"


def build(tree, output, *kinds):
    pytest.importorskip("build", reason="the extra dev is not installed")
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", output, *kinds, tree]
    result = subprocess.run(list(map(str, command)), capture_output=True, text=True)
    assert result.returncode == 0, result.stdout + result.stderr


def contents(wheel):
    """Bytes of each file of a wheel."""
    with zipfile.ZipFile(wheel) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


@pytest.fixture(scope="module")
def distributions(tmp_path_factory):
    """The wheel and the source distribution."""
    folder = os.environ.get("LUMITREE_DISTRIBUTIONS")
    if folder is None:
        tree = tmp_path_factory.mktemp("tree") / "lumitree"
        # Beside what earlier builds have left, such as modules that do not exist any more.
        left = shutil.ignore_patterns(".*", "*.egg-info", "__pycache__", "build", "dist", "docs")
        shutil.copytree(ROOT, tree, ignore=left)
        folder = tmp_path_factory.mktemp("dist")
        build(tree, folder, "--sdist", "--wheel")
    (wheel,) = Path(folder).glob(f"lumitree-{__version__}-*.whl")
    (source,) = Path(folder).glob(f"lumitree-{__version__}.tar.gz")
    return wheel, source


def files_of_package():
    return {
        path.relative_to(PACKAGE.parent).as_posix()
        for path in PACKAGE.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }


def test_the_wheel_has_the_package_alone(distributions):
    wheel, _ = distributions
    assert wheel.name == f"lumitree-{__version__}-py3-none-any.whl"
    info = f"lumitree-{__version__}.dist-info"
    names = set(contents(wheel))
    package = {name for name in names if not name.startswith(info)}
    assert package == files_of_package()
    for name in ("py.typed", "viewer/page/template.html", "__init__.pyi"):
        assert f"lumitree/{name}" in package
    assert "lumitree/exports/blender_files/lumitree-blender.zip" in package
    assert f"{info}/licenses/LICENSE" in names
    assert f"{info}/entry_points.txt" in names


def test_the_wheel_says_what_it_needs(distributions):
    wheel, _ = distributions
    files = contents(wheel)
    info = f"lumitree-{__version__}.dist-info"
    metadata = BytesParser().parsebytes(files[f"{info}/METADATA"])
    assert metadata["Version"] == __version__
    assert metadata["License-Expression"] == "BSD-3-Clause"
    assert metadata["Requires-Python"] == ">=3.11"
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    _, _, description = files[f"{info}/METADATA"].decode().partition("\n\n")
    assert description.strip() == readme.strip()
    assert any(
        each.startswith("mitsuba<3.10,>=3.9") for each in metadata.get_all("Requires-Dist", [])
    )
    # Places of the machine that built it.
    assert not [name for name, data in files.items() if str(ROOT).encode() in data]


def test_the_source_distribution_makes_the_same_wheel(distributions, tmp_path):
    wheel, source = distributions
    with tarfile.open(source) as archive:
        archive.extractall(tmp_path, filter="data")
    (tree,) = tmp_path.iterdir()
    found = {path.relative_to(tree).as_posix() for path in tree.rglob("*") if path.is_file()}
    outside = {name for name in found if not name.startswith("src/")}
    assert outside == BESIDE
    inside = {name.removeprefix("src/") for name in found - outside}
    assert {name for name in inside if "egg-info" not in name} == files_of_package()
    build(tree, tmp_path / "again", "--wheel")
    (again,) = (tmp_path / "again").glob("*.whl")
    assert contents(again) == contents(wheel)


@dataclasses.dataclass(frozen=True)
class Program:
    """An installed program: a call runs it, or another one, in a folder and returns its output."""

    path: Path
    folder: Path
    python: Path
    site: Path

    def __call__(self, *arguments, program=None):
        environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
        result = subprocess.run(
            [program or self.path, *arguments],
            cwd=self.folder,
            env=environment,
            capture_output=True,
            text=True,
            encoding="utf-8",
        )
        assert result.returncode == 0, result.stderr
        return result.stdout


@pytest.fixture(scope="module")
def program(distributions, tmp_path_factory):
    """The installed program, which uses the libraries of this environment.

    The wheel is installed into a new environment. A .pth file names the folders of its libraries,
    so nothing is downloaded; .pth files in these, as of an editable lumitree, have no effect.
    """
    wheel, _ = distributions
    home = tmp_path_factory.mktemp("with space") / "Umgebung ü"
    venv.create(home)
    scripts = home / ("Scripts" if os.name == "nt" else "bin")
    python = scripts / Path(sys.executable).name
    if not python.exists():
        python = scripts / "python"
    install = [sys.executable, "-m", "pip", "--python", str(python), "install", "--quiet"]
    subprocess.run([*install, "--no-index", "--no-deps", str(wheel)], check=True)
    own = sysconfig.get_path("purelib", vars={"base": str(home), "platbase": str(home)})
    outer = [sysconfig.get_path("purelib"), sysconfig.get_path("platlib")]
    (Path(own) / "libraries.pth").write_text("\n".join(outer), encoding="utf-8")
    folder = tmp_path_factory.mktemp("work") / FOLDER
    folder.mkdir()

    return Program(scripts / "lumitree", folder, python, Path(own))


def test_the_installed_program_runs(program):
    code = "import lumitree; print(lumitree.__file__)"
    where = program("-c", code, program=program.python)
    assert Path(where.strip()).is_relative_to(program.site)
    assert "Usage: lumitree" in program("--help")
    assert program("--version").strip() == f"lumitree {__version__}"
    assert "bulbs" in program("list")
    program("blender-extension", "-o", "lumitree.zip")
    with zipfile.ZipFile(program.folder / "lumitree.zip") as archive:
        assert "blender_manifest.toml" in archive.namelist()


def test_the_demonstration_runs_from_the_installation(program):
    program("demo", "-o", "Bilder ä")
    for name in ("comparison.png", "report.json"):
        assert (program.folder / "Bilder ä" / name).stat().st_size > 1000
    assert list((program.folder / "Bilder ä").glob("*.lumitree"))
