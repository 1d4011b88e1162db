"""Table 8: memory, precomputation and overhead, from the cells of the other tables."""

from typing import Any

from benchmarks.paper_tables.cells import Found
from benchmarks.paper_tables.scales import LAMPS

# As the paper's text has them.
PAPER_BYTES = 1.7e9
PAPER_DAYS = "12 to 36 h of views (32 threads), 1 to 2 days of training (RTX 2080 Ti)"
PAPER_OVERHEAD = 0.20


def section(found: Found) -> str:
    """The paper's figures, and a row for each lamp."""
    heads = ["lamp", "octree of the network, MB", "octree fit, MB"]
    heads += ["views + training + octree, min", "peak GB", "octree fit, min", "peak GB"]
    heads += ["paper's way, overhead a sample", "divided, overhead a sample"]
    paper = ["paper", f"{PAPER_BYTES / 1e6:.0f} (depth 10)", "", PAPER_DAYS, "", "", ""]
    rows = [[*paper, f"+{PAPER_OVERHEAD:.0%}", ""]]
    for lamp in LAMPS:
        network, direct = (found.record(f"1-{lamp}-{kind}") for kind in ("network", "direct"))
        equal = found.record(f"5-{lamp}")
        row = [lamp, _megabytes(found, network), _megabytes(found, direct)]
        row += [_minutes(found, network), _peak(found, network)]
        row += [_minutes(found, direct), _peak(found, direct)]
        row += [_overhead(found, equal, name) for name in ("proxy", "divided")]
        rows.append(row)
    return found.table(heads, rows)


def _megabytes(found: Found, record: dict[str, Any] | None) -> str:
    return found.number(None if record is None else record["values"]["bytes"] / 1e6, 1)


def _minutes(found: Found, record: dict[str, Any] | None) -> str:
    if record is None:
        return found.missing
    seconds = [each for each in record["values"]["costs"].values() if not isinstance(each, dict)]
    return f"{sum(seconds) / 60:.1f}"


def _peak(found: Found, record: dict[str, Any] | None) -> str:
    peak = None if record is None else record["values"]["peak_memory_bytes"] / 1e9
    return found.number(peak, 1)


def _overhead(found: Found, record: dict[str, Any] | None, name: str) -> str:
    if record is None:
        return found.missing
    paces = record["values"]["seconds_per_sample"]
    return f"{paces[name] / paces['explicit'] - 1:+.0%}"
