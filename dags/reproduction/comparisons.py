"""Tables 1 to 3: the paper's rows as printed, then every method that was run here, over full picture and box."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from posegaussian.dags.ablation.groups import FOOTAGE
from posegaussian.dags.ablation.paper_form import PICTURE
from posegaussian.dags.evaluation.measured import DEVIATION, MEAN
from posegaussian.dags.evaluation.results import SIMULATED, Key, Result, overall
from posegaussian.dags.paper.printed import OURS, table
from posegaussian.dags.reproduction.page import HERE, NOT_RUN, Page, Part, printed, record
from posegaussian.dags.reproduction.people import Measured, Wanted

REGIONS = ("full", "box")
"""Of the rows that were measured here; the paper names none."""
TIMES = "Train/FPS"
SETUPS = ("6 cameras", "8 cameras", "real world", "rendered")
THUMAN = "THuman2.0"
SETS = {"table1": tuple(table("table1").rows), "table2": (THUMAN,)}
SETS["table3"] = (*SETS["table1"], THUMAN)
"""{table: data sets of the paper that it takes}."""
WANTED = {
    "table1": (Wanted("people8", FOOTAGE["cameras"]),),
    "table2": tuple(Wanted(f"people{n}", FOOTAGE["cameras"], n) for n in (6, 8)),
    "table3": (Wanted("motion8", FOOTAGE["tps"], frames=3),),
}
"""{table: simulated people that it takes}."""
COMPARABLE = (
    "Comparable: rows that were measured here on the same data, with each other. Not comparable: these with the"
    " paper's, which are of other data, or of frames, views and cameras that it does not name, at 512 x 512 px, and"
    " of neither a region nor an LPIPS network that it names."
)
ON_TIMES = (
    f" {TIMES} here: training of the weights and, where a method optimises, seconds a frame; frames a second of all"
    " stages from filmed pictures on."
)
Cell = tuple[str, str]
"""Text and definition of a number."""


def table1(found: Measured) -> Page:
    """A part a data set, then one of simulated people, with the paper's own rows of every data set."""
    its = table("table1")
    parts = [_data_set(name, rows, found.of(name), its.label) for name, rows in its.rows.items()]
    own = {f"{OURS} on {name}": rows[OURS] for name, rows in its.rows.items()}
    parts.append(_data_set(SIMULATED, own, found.of(SIMULATED), its.label))
    title = "Table 1, methods on each data set"
    return Page("table1", title, its.label, parts, [COMPARABLE + ON_TIMES, *_told(found, "table1")], found.status)


def _data_set(name: str, rows: Mapping[str, Any], results: Sequence[Result], label: str) -> Part:
    columns = [*PICTURE, *([TIMES] if any(TIMES in row for row in rows.values()) else [])]
    part = Part(name, ["method", *columns], [], [])
    for method, row in rows.items():
        part.body.append([method, *(row.get(c, "-") for c in columns)])
        part.records.extend(printed(method, label, columns, row, data_set=name))
    _here(part, name, results, columns, _picture)
    return part


def table2(found: Measured) -> Page:
    """Methods by number of cameras, on THuman2.0 and on simulated people."""
    its = table("table2")
    columns = [f"{setup} {m}" for setup in SETUPS for m in PICTURE]
    part = Part("", ["method", *columns], [], [])
    for method, by_setup in its.rows.items():
        row = {f"{setup} {m}": value for setup, of in by_setup.items() for m, value in of.items()}
        part.body.append([method, *(row.get(c, "-") for c in columns)])
        part.records.extend(printed(method, its.label, columns, row, data_set=THUMAN))
    for name in (THUMAN, SIMULATED):
        by_setup = {f"{n} cameras": {r.method: r for r in overall(found.of(name, n))} for n in (6, 8)}
        _setups(part, name, by_setup, columns)
    title = "Table 2, THuman2.0 with 6 and 8 cameras"
    return Page("table2", title, its.label, [part], [COMPARABLE, *_told(found, "table2")], found.status)


def _setups(part: Part, name: str, by_setup: Mapping[str, Mapping[str, Result]], columns: Sequence[str]) -> None:
    methods = list(dict.fromkeys(m for of in by_setup.values() for m in of))
    if not methods:
        part.body.append(_nothing(name, columns))
    for method in methods:
        ran = any(of[method].numbers for of in by_setup.values() if method in of)
        if not ran:
            part.body.append(_nothing(f"{method} on {name}", columns))
        for region in REGIONS if ran else ():
            row = f"{HERE}{method} on {name}, {region}"
            cells = []
            for column in columns:
                setup, measure = column.rsplit(" ", 1)
                result = by_setup.get(setup, {}).get(method)
                if setup in by_setup and (result is None or not result.numbers):
                    cells.append(NOT_RUN)
                    continue
                text, told = _picture(result, measure, region) if result is not None else ("-", "")
                cells.append(text)
                if told:
                    about = {"data_set": name, "method": method, "region": region}
                    part.records.append(record(row, column, text, told, **about))
            part.body.append([row, *cells])


def table3(found: Measured, ablated: Sequence[Sequence[str]]) -> Page:
    """Change of SSIM from frame to frame; `ablated` are rows on what the stabilizer is worth."""
    its = table("table3")
    columns = ["µ(ΔSSIM)", "σ(ΔSSIM)"]
    part = Part("", ["method", *columns], [], [])
    for method, row in its.rows.items():
        part.body.append([method, *(row.get(c, "-") for c in columns)])
        part.records.extend(printed(method, its.label, columns, row))
    for name in (*SETS["table3"], SIMULATED):
        if found.of(name) or name == SIMULATED:
            _here(part, name, found.of(name), columns, _change, f" on {name}")
    absent = [name for name in SETS["table3"] if not found.of(name)]
    if absent:
        part.body.append(_nothing(", ".join(absent), columns))
    part.body.extend([f"{HERE}`ablate`, simulated people, box: {name}", *cells] for name, *cells in ablated)
    title = "Table 3, change of SSIM from frame to frame"
    more = (
        " The change follows from motion, frame rate and region as much as from the method, and the paper names neither"
        " its 32 sequences nor a region."
    )
    return Page("table3", title, its.label, [part], [COMPARABLE + more, *_told(found, "table3")], found.status)


def _here(
    part: Part,
    name: str,
    results: Sequence[Result],
    columns: Sequence[str],
    cell: Callable[[Result, str, str], Cell],
    on: str = "",
) -> None:
    """A row a method and region, of means over the sequences of a data set."""
    if not results:
        part.body.append(_nothing(name, columns))
    for result in overall(results):
        for region in REGIONS if result.numbers else ("",):
            row = f"{HERE}{result.method}{on}{f', {region}' if region else ''}"
            found = [cell(result, c, region) if region else (NOT_RUN, result.why) for c in columns]
            part.body.append([row, *(text for text, _ in found)])
            about = {"data_set": name, "method": result.method, "region": region or None}
            part.records.extend(
                record(row, c, text, told, **about) for c, (text, told) in zip(columns, found, strict=True)
            )


def _nothing(name: str, columns: Sequence[str]) -> list[str]:
    return [f"{HERE}{name}", *(NOT_RUN for _ in columns)]


def _picture(result: Result, column: str, region: str) -> Cell:
    """PSNR, SSIM, LPIPS on the network that was measured, or times."""
    if column == TIMES:
        return _times(result)
    names = {"LPIPS": ("lpips_alex", "lpips_vgg")}.get(column, (column.lower(),))
    keys: list[Key] = [(m, region, MEAN) for m in names]
    key = next((k for k in keys if result.value(k) is not None), keys[0])
    return _number(result, key, 2 if column == "PSNR" else 3)


def _change(result: Result, column: str, region: str) -> Cell:
    return _number(result, ("delta_ssim", region, MEAN if column.startswith("µ") else DEVIATION), 4)


def _number(result: Result, key: Key, digits: int) -> Cell:
    value = result.value(key)
    told = result.numbers[key].told if key in result.numbers else "not measured"
    return ("-", told) if value is None else (f"{value:.{digits}f}", told)


def _times(result: Result) -> Cell:
    keys: list[Key] = [(m, "", MEAN) for m in ("trained", "optimised", "frames_a_second")]
    trained, optimised, rate = (result.value(k) or 0.0 for k in keys)
    told = "; ".join(result.numbers[k].definition for k in keys if k in result.numbers)
    spent = [f"{trained / 60:.0f}m"] if trained else []
    spent += [f"{optimised:.3g}s a frame"] if optimised else []
    return f"{' + '.join(spent) or '0'} / {rate:.3g}", told


def _told(found: Measured, name: str) -> Iterator[str]:
    """Why something was not run, then the protocols."""
    if absent := [s for s in SETS[name] if not found.of(s)]:
        yield (
            f"{', '.join(absent)}: not run, the archive has no such sequence with held-out cameras;"
            " docs/guide/datasets.md says how each comes in."
        )
    yield from dict.fromkeys(
        f"{r.method} was not run on {r.sequence}: {r.why}." for _, r in found.results if not r.numbers
    )
    yield from dict.fromkeys(found.protocols)
