"""IES LM-63 and EULUMDAT files, by the libraries photompy and eulumdat-py."""

import datetime
import os
import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from lumitree.core.files import atomic_path, write_bytes
from lumitree.core.reading import read_bytes
from lumitree.errors import LumitreeError, shown
from lumitree.goniophotometry.type_c import IntensityDistribution, completed

T = TypeVar("T")
MAX_FILE_BYTES = 1 << 24
# Largest number of C planes, of γ angles and of sets of lamps.
MAX_ANGLES, MAX_SETS = 3601, 20
_METRES_PER_FOOT = 0.3048
# Significant digits of the largest intensity in a file.
_DIGITS = 7
# EULUMDAT limits the length of text lines.
_TEXT = 78
_MAKER = "lumitree"


def write_ies(path: str | os.PathLike[str], distribution: IntensityDistribution) -> None:
    """Write an IES LM-63-2019 file of Type C, marked as simulated.

    The number of lamp lumens is the flux of the bare emitters, or -1 (absolute photometry) if that
    is not known. The length of the luminous opening is its side along C = 0, the width that along
    C = 90.

    Raises:
        LumitreeError: the file cannot be written.
    """
    from photompy import IESFile, PhotometricType, Photometry

    planes = np.append(distribution.c, distribution.c[0] + 360)
    values = np.concatenate([distribution.intensity, distribution.intensity[:1]])
    photometry = Photometry(distribution.gamma, planes, values, PhotometricType.C)
    largest = float(values.max(initial=0)) or 1.0
    length, height, width = distribution.opening
    emitted = distribution.emitted_lumens
    file = IESFile.from_photometry(
        photometry,
        manufacturer=_MAKER,
        lumcat=_line(distribution.name),
        luminaire=_line(distribution.name),
        test="simulated",
        testlab=_MAKER,
        issuedate=datetime.date.today().isoformat(),
        lumens_per_lamp=-1 if emitted is None else round(emitted, 4),
        width=round(width, 6),
        length=round(length, 6),
        height=round(height, 6),
    )
    # photompy writes two decimals by default, which loses intensities of some millicandela.
    decimals = max(3, _DIGITS - int(np.ceil(np.log10(largest))))
    write_bytes(path, _numbers_in_full(file.write(precision=decimals) or b""))


def write_ldt(path: str | os.PathLike[str], distribution: IntensityDistribution) -> None:
    """Write an EULUMDAT file; see `ldt_of`.

    Raises:
        LumitreeError: the file cannot be written.
    """
    from pyldt import LdtWriter

    file = ldt_of(distribution, Path(path).name)
    with atomic_path(path) as temporary:
        LdtWriter.write(file, temporary, overwrite=True)


def ldt_of(distribution: IntensityDistribution, file_name: str = "") -> Any:
    """EULUMDAT data (`pyldt.Ldt`), without symmetry.

    The flux of the lamps is that of the bare emitters. If it is not known, it is that of the
    luminaire, and the number of lamps is -1 (absolute photometry). Direct ratios are 0.
    """
    from pyldt import Ldt, LdtHeader

    lumens, emitted = distribution.lumens, distribution.emitted_lumens
    lamp_lumens = (emitted or lumens) or 1.0
    # As written: the intensities are relative to it.
    lamp_lumens = float(f"{lamp_lumens:.6f}") or lamp_lumens
    c, gamma = distribution.c, distribution.gamma
    below = np.where(gamma <= 90, distribution.intensity, 0)
    angles = IntensityDistribution("", c, gamma, below).lumens
    width, height, length = (1000 * side for side in distribution.opening)
    header = LdtHeader(
        company=_MAKER,
        ityp=3,
        isym=0,
        mc=len(c),
        dc=_step(c),
        ng=len(gamma),
        dg=_step(gamma),
        report_number="simulated",
        luminaire_name=_line(distribution.name),
        luminaire_number=_line(distribution.name),
        file_name=_line(file_name),
        date_user=datetime.date.today().isoformat(),
        length=length,
        width=width,
        height=height,
        length_lum_area=length,
        width_lum_area=width,
        h_lum_c0=height,
        h_lum_c90=height,
        h_lum_c180=height,
        h_lum_c270=height,
        dff=100 * angles / lumens if lumens else 0.0,
        lorl=100.0 if emitted is None else 100 * lumens / lamp_lumens,
        n_sets=1,
        num_lamps=[-1 if emitted is None else 1],
        lamp_types=["simulated"],
        lamp_flux=[lamp_lumens],
        lamp_cct=[""],
        lamp_cri=[""],
        lamp_watt=[0.0],
        direct_ratios=[0.0] * 10,
        c_angles=c.tolist(),
        g_angles=gamma.tolist(),
    )
    return Ldt(header, (distribution.intensity * (1000 / lamp_lumens)).tolist())


def read_ies(path: str | os.PathLike[str]) -> IntensityDistribution:
    """Read an IES LM-63 file of Type C, of any version that photompy reads.

    Raises:
        LumitreeError: the file is missing, damaged, of another type, or needs TILT data.
    """
    content = read_bytes(path, "an IES file", MAX_FILE_BYTES)

    def parse() -> IntensityDistribution:
        from photompy import IESFile, PhotometricType

        # Files are in all encodings, and numbers may be separated by commas.
        text = _decoded(content)
        _check_length(text)
        file = IESFile.read(_with_version(text).encode(), strict=False)
        header, values = file.header, file.photometry
        if values.photometric_type != PhotometricType.C:
            raise LumitreeError(f"it has photometry of Type {values.photometric_type.name}, not C")
        if header.tilt not in (None, "NONE"):
            raise LumitreeError("it has a TILT table, which changes intensities with attitude")
        scale = header.ballast_factor * (header.future_use if _is_factor(header) else 1.0)
        c, gamma, intensity = completed(values.phis, values.thetas, values.values * scale)
        metres = 1.0 if int(header.units) == 2 else _METRES_PER_FOOT
        sides = [abs(side) * metres for side in (header.length, header.height, header.width)]
        emitted = header.lumens_per_lamp * header.num_lamps
        return IntensityDistribution(
            name=shown(header.keywords.get("LUMINAIRE") or Path(path).stem),
            c=c,
            gamma=gamma,
            intensity=intensity,
            opening=(sides[0], sides[1], sides[2]),
            emitted_lumens=emitted if header.lumens_per_lamp > 0 and emitted > 0 else None,
        )

    return _parsed(path, "IES LM-63 file of Type C", parse)


def read_ldt(path: str | os.PathLike[str]) -> IntensityDistribution:
    """Read an EULUMDAT file; the first set of lamps is taken.

    Raises:
        LumitreeError: the file is missing or damaged.
    """
    content = read_bytes(path, "an EULUMDAT file", MAX_FILE_BYTES)

    def parse() -> IntensityDistribution:
        from pyldt import LdtReader

        _check_counts(content)
        file = LdtReader.read(Path(path))
        header = file.header
        scale = header.lamp_flux[0] / 1000 * (header.conv_factor or 1.0)
        values = np.array(file.intensities, np.float64) * scale
        c = np.array(header.c_angles, np.float64)
        c, gamma, intensity = completed(c, np.array(header.g_angles, np.float64), values)
        heights = [header.h_lum_c0, header.h_lum_c90, header.h_lum_c180, header.h_lum_c270]
        # A width of 0 is that of a round opening, whose diameter is the length.
        length = header.length_lum_area / 1000
        return IntensityDistribution(
            name=shown(header.luminaire_name or Path(path).stem),
            c=c,
            gamma=gamma,
            intensity=intensity,
            opening=(header.width_lum_area / 1000 or length, max(heights) / 1000, length),
            emitted_lumens=header.lamp_flux[0] if header.num_lamps[0] > 0 else None,
        )

    return _parsed(path, "EULUMDAT file", parse)


def _parsed(path: str | os.PathLike[str], kind: str, parse: Callable[[], T]) -> T:
    """The result of a library's parser; all of its exceptions become one line."""
    name = shown(path, 300)
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            # photompy warns where it guesses what a number means.
            warnings.simplefilter("error", UserWarning)
            warnings.filterwarnings("ignore", "Unsupported IES version")
            return parse()
    except LumitreeError as error:
        raise LumitreeError(f"{name} is not a usable {kind}: {error}") from None
    except ImportError:
        raise
    except Exception as error:
        # The libraries have no common base class, and raise whatever a damaged number causes.
        reason = shown(" ".join(str(error).split()) or type(error).__name__)
        raise LumitreeError(f"{name} is not a readable {kind}: {reason}") from None


def _check_counts(content: bytes) -> None:
    """Refuse numbers of angles and of sets of lamps before memory is reserved for them."""
    lines = [line.strip() for line in content.decode("latin-1").splitlines()]
    if len(lines) < 40:
        raise LumitreeError(f"it has {len(lines)} lines")
    sets = [line for line in lines[12:] if line][13]
    for what, text, low, high in (
        ("as kind of symmetry", lines[2], 0, 4),
        ("C planes", lines[3], 1, MAX_ANGLES),
        ("gamma angles", lines[5], 2, MAX_ANGLES),
        ("sets of lamps", sets, 1, MAX_SETS),
    ):
        count = float(text.replace(",", "."))
        if not low <= count <= high:
            raise LumitreeError(f"it has {shown(text, 20)} {what}; expected {low} to {high}")


def _decoded(content: bytes) -> str:
    """Text of a file with newlines only, and without commas between the numbers."""
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    head, tilt, numbers = text.partition("TILT=")
    return head + tilt + numbers.replace(",", " ")


def _check_length(text: str) -> None:
    """Refuse an IES file that ends before its last intensity.

    Without TILT data, 13 numbers come first, the fourth and fifth of which count the angles.
    """
    words = text.partition("TILT=NONE")[2].split()
    if len(words) < 5 or not all(word.isdecimal() for word in words[3:5]):
        return  # the library says what is wrong
    gamma, c = (int(word) for word in words[3:5])
    expected = 13 + gamma + c + gamma * c
    if len(words) < expected:
        raise LumitreeError(
            f"it has {len(words)} numbers, expected {expected} for {gamma} x {c} intensities and "
            "their angles; the file is cut off"
        )


def _with_version(text: str) -> str:
    """Text with a first line that photompy parses; files before 1995 have none, or `IESNA91`."""
    first, _, rest = text.partition("\n")
    if re.fullmatch(r"IES(NA)?:\s*LM-63-\d{4}\s*", first):
        return text
    return f"IESNA:LM-63-1991\n{rest if first.startswith('IES') else text}"


def _is_factor(header: Any) -> bool:
    """Whether the number after the ballast factor is one too, as before the version of 2002."""
    return not re.search("2002|2019", str(header.version)) and header.future_use > 0


def _numbers_in_full(content: bytes) -> bytes:
    """photompy writes tiny numbers with an exponent, which some readers do not accept."""
    return b"\n".join(
        b" ".join(
            np.format_float_positional(float(word), trim="-").encode() if b"e-" in word else word
            for word in line.split(b" ")
        )
        if b"[" not in line
        else line
        for line in content.split(b"\n")
    )


def _line(text: str) -> str:
    """Text for one line of a file: printable characters of Latin-1."""
    return shown(text, _TEXT).replace("…", ".").encode("latin-1", "replace").decode("latin-1")


def _step(angles: np.ndarray[Any, Any]) -> float:
    """Step of equidistant angles; 0 for others, as EULUMDAT has it."""
    steps = np.diff(angles)
    return float(steps[0]) if len(steps) and np.ptp(steps) < 1e-6 else 0.0
