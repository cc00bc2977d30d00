"""The page of an inspection: one HTML file that needs nothing but the pictures beside it."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path
from urllib.parse import quote

from posegaussian.dags.inspection.figures import PairPicture
from posegaussian.dags.inspection.portraits import NAMED, Portrait, who_is_who
from posegaussian.stages.inspection.finding import Finding, FindingVerdict, by_measure
from posegaussian.stages.inspection.footage import Footage
from posegaussian.stages.inspection.report import Report
from posegaussian.storage.files.write import write_atomically

COLORS = {
    FindingVerdict.GOOD: "#2f9e63",
    FindingVerdict.DOUBTFUL: "#c77700",
    FindingVerdict.BAD: "#c92a2a",
    FindingVerdict.LEFT_OUT: "#8a4fa3",
    FindingVerdict.UNKNOWN: "#7a828e",
    FindingVerdict.NOTE: "#3b6fb6",
}
STYLE = """
body{font:15px/1.45 Helvetica,Arial,'DejaVu Sans',sans-serif;
color:#1d2430;margin:2rem auto;max-width:1240px;padding:0 1rem}
h1{font-size:1.5rem;margin:0 0 .6rem}h2{font-size:1.15rem;margin:2rem 0 .5rem}
.verdict{color:#fff;border-radius:7px;padding:.7rem 1rem;font-size:1.1rem}
ol li{margin:.45rem 0}.do{display:block;font-weight:bold}
table{border-collapse:collapse;width:100%;font-size:.88rem}
th,td{text-align:left;vertical-align:top;padding:.28rem .6rem .28rem 0;border-bottom:1px solid #e3e6ea}
td.n{white-space:nowrap}.mark{color:#fff;border-radius:4px;padding:.05rem .45rem;white-space:nowrap;font-size:.82rem}
figure{margin:1.2rem 0}figure img{max-width:100%;border-radius:4px;display:block}
.people{display:flex;flex-wrap:wrap;gap:1rem}.people figure{margin:0;max-width:14rem}
figcaption{font-size:.88rem;margin:.35rem 0}
.key span{margin-right:1.2rem}.key i{display:inline-block;width:.8em;height:.8em;border-radius:50%;
margin-right:.35em;border:1px solid #888}
"""
KEY = (
    ("#ffd200", "joint as seen"),
    ("#00e6ff", "where the cameras together put it"),
    ("#ffffff", "outline of the mask"),
    ("#ff00c8", "what the other masks leave"),
)


def write_page(
    name: str,
    footage: Footage,
    report: Report,
    pictures: Sequence[PairPicture],
    file: Path,
    people: Sequence[tuple[Portrait, Path]] = (),
) -> Path:
    """Write the page; pictures, those of `people` too, are linked relative to it."""
    write_atomically(file, page(name, footage, report, pictures, file.parent, people).encode())
    return file


def page(
    name: str,
    footage: Footage,
    report: Report,
    pictures: Sequence[PairPicture],
    folder: Path,
    people: Sequence[tuple[Portrait, Path]] = (),
) -> str:
    """The page's text: the verdict in one sentence, what to do, what a run will make of it,
    the people, the pictures, and all numbers."""
    width, height = footage.captured.max(axis=0)
    about = (
        f"{len(footage.rig)} camera{'s' if len(footage.rig) > 1 else ''} of up to {width}x{height} px,"
        f" {len(footage.common)} frames at {footage.frame_rate:g} a second; looked at: frames"
        f" {', '.join(map(str, footage.looked_at))}"
    )
    parts = [
        (
            f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{escape(name)}:'
            f" inspection</title><style>{STYLE}</style></head><body>"
        ),
        f"<h1>{escape(name)}</h1>",
        (
            '<p class="verdict"'
            f' style="background:{COLORS[report.verdict]}">{escape(report.sentence)}</p><p>{escape(about)}.</p>'
        ),
        _to_do(report),
        "<h2>What a run will make of it</h2><ul>"
        + "".join(f"<li>{escape(line)}</li>" for line in report.outlook)
        + "</ul>",
        _unmeasured(report),
        _people(people, folder, who_is_who([p for p, _ in people], report.findings)),
        "<h2>Pairs of cameras</h2>",
        '<p class="key">' + "".join(f'<span><i style="background:{c}"></i>{t}</span>' for c, t in KEY) + "</p>",
        (
            "<p>Points of one colour are matched; each must lie on the line of its colour, which is where the"
            " calibration says that the other camera's point can be.</p>"
        ),
        *(_figure(p, report.findings, footage.names, folder) for p in pictures),
        "<h2>All numbers</h2>",
        _table(by_measure(report.findings)),
        "</body></html>\n",
    ]
    return "\n".join(parts)


def _people(people: Sequence[tuple[Portrait, Path]], folder: Path, said: Sequence[str] = ()) -> str:
    """Everybody with a picture, and what is `said` of them beyond their captions; nothing where nobody was found."""
    if not people:
        return ""
    figures = "".join(
        f'<figure><img src="{_source(file, folder)}"'
        f' alt="{escape(p.name, quote=True)}"><figcaption>{escape(p.sentence)}</figcaption></figure>'
        for p, file in people
    )
    captions = {p.sentence for p, _ in people}
    notes = "".join(f"<p>{escape(s)}.</p>" for s in said if s not in captions)
    return f'<h2>People</h2>{notes}<p>{escape(NAMED)}</p><div class="people">{figures}</div>'


def _source(file: Path, folder: Path) -> str:
    """Where an img finds a picture: names of cameras may hold what means something else in a URL."""
    return quote(file.relative_to(folder).as_posix())


def _to_do(report: Report) -> str:
    if not report.to_do:
        return "<p>There is nothing to do.</p>" if report.verdict is FindingVerdict.GOOD else ""
    items = [
        f'<li>{_mark(verdict)} <span class="do">{escape(advice)}</span>{escape(found)}</li>'
        for verdict, found, advice in report.to_do
    ]
    return "<h2>What to do, the most useful first</h2><ol>" + "".join(items) + "</ol>"


def _unmeasured(report: Report) -> str:
    if not report.unmeasured:
        return ""
    return "<h2>Not measured</h2><ul>" + "".join(f"<li>{escape(u)}</li>" for u in report.unmeasured) + "</ul>"


def _mark(verdict: FindingVerdict) -> str:
    return f'<span class="mark" style="background:{COLORS[verdict]}">{verdict}</span>'


def _table(findings: Sequence[Finding]) -> str:
    head = "".join(f"<th>{h}</th>" for h in ("measure", "of", "number", "verdict", "bounds", "what was found"))
    rows = "".join(
        f'<tr><td class="n">{escape(f.measure)}</td><td class="n">{escape(f.about)}</td><td'
        f' class="n">{escape(f.number)}</td><td>{_mark(f.verdict)}</td><td>{escape(f.bounds)}</td>'
        f"<td>{escape(f.sentence)}{f'<br><b>{escape(f.advice)}</b>' if f.advice else ''}</td></tr>"
        for f in findings
    )
    return f"<table><tr>{head}</tr>{rows}</table>"


def _figure(picture: PairPicture, findings: Sequence[Finding], names: Sequence[str], folder: Path) -> str:
    """A pair's picture with what was found of the pair itself."""
    cameras = tuple(names[v] for v in dict.fromkeys(picture.views))
    own = [f for f in findings if f.cameras == cameras and len(cameras) == 2]
    told = "".join(f"<br>{_mark(f.verdict)} {escape(f.measure)}: {escape(f.sentence)}" for f in own)
    return (
        f'<figure><img src="{_source(picture.file, folder)}" alt="{escape(picture.caption, quote=True)}">'
        f"<figcaption><b>{escape(picture.caption)}</b>{told}</figcaption></figure>"
    )
