"""TM-25 ray files by the published layout, written without lumitree."""

import struct

import numpy as np

# Where the rays begin in a file without spectral tables.
HEADER = 288 + 9 * 4000


def file_bytes(
    rows,
    flags,
    spectrum=0,
    wavelengths=(np.nan,) * 3,
    tables=(),
    additional=0,
    text=0,
    totals=(0, 0),
):
    """A file by the published layout, written without the module.

    Args:
        rows: [N, M] numbers of the rays.
        flags: the 8 known data flags.
        tables: spectral tables, [n, 2] each.
        additional, text: number of additional items, and bytes of the additional text.
        totals: luminous flux and radiant flux in the header.
    """
    head = b"TM25" + struct.pack("<iiffQ", 2013, 1, *totals, len(rows))
    head += b"2026-11-23T12:00:00Z".ljust(28, b"\0")
    head += struct.pack("<iifffiii", 7, spectrum, *wavelengths, len(tables), additional, text)
    head += bytes(168) + struct.pack("<8i", *flags)
    head += "light ☀".encode("utf-32-le").ljust(4000, b"\0") + bytes(8 * 4000)
    assert len(head) == HEADER
    spectra = b"".join(
        struct.pack("<i", len(table)) + np.array(table, "<f4").tobytes() for table in tables
    )
    spectra += bytes(-len(spectra) % 32)
    return head + spectra + bytes(512 * additional + text) + np.array(rows, "<f4").tobytes()
