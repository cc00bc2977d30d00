"""The page of an archive: one HTML file without a script, that asks for nothing and is read on any screen.

What comes from outside, such as names of sequences and sentences of errors, is escaped wherever it is put.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from html import escape

from posegaussian.dags.humanize.text import number, seconds_text
from posegaussian.dags.report.account import Account
from posegaussian.dags.report.curves import plot
from posegaussian.dags.report.flow import flow
from posegaussian.dags.report.pictures import Drawn

COLORS = {"done": "#2f9e63", "warnings": "#a86400", "failed": "#c92a2a", "unfinished": "#3b6fb6", "empty": "#6a727e"}
FRAME_SECONDS = 0.16
"""That a frame of a strip stays: twelve frames are a motion of two seconds."""
STYLE = """
*{box-sizing:border-box}body{font:15px/1.45 Helvetica,Arial,'DejaVu Sans',sans-serif;color:#1d2430;background:#f6f7f9;
margin:0 auto;max-width:1120px;padding:1rem;overflow-wrap:anywhere}
h1{font-size:1.45rem;margin:.2rem 0 .4rem}h2{font-size:1.15rem;margin:0}h3{font-size:.95rem;margin:1rem 0 .3rem}
a{color:inherit}p{margin:.3rem 0}ul{margin:.2rem 0;padding-left:1.2rem}
.grid{display:grid;grid-template-columns:repeat(auto-fill,minmax(150px,1fr));gap:.7rem;margin:1rem 0}
.card,section{background:#fff;border:1px solid #e1e4e8;border-radius:8px}
.card{display:block;padding:.6rem;text-decoration:none;font-size:.88rem}.card b{display:block;margin-top:.4rem}
.none{display:block;height:140px;line-height:140px;text-align:center;background:#eceff2;color:#5b6470;border-radius:4px}
section{padding:.9rem 1rem;margin:1rem 0}.mark{color:#fff;border-radius:4px;padding:.05rem .45rem;font-size:.8rem}
.plays{display:block;overflow:hidden;background:#000;border-radius:4px;max-width:100%;margin:0 auto;position:relative}
.plays img{display:block;width:100%;position:absolute;top:0;left:0}
figure{margin:.3rem 0}figure>img{max-width:100%;display:block;border-radius:4px}
figcaption{font-size:.82rem;color:#4a5360}
.row{display:flex;flex-wrap:wrap;gap:1rem;align-items:flex-start}.row>figure{flex:0 1 auto;max-width:100%}
.plots{display:grid;grid-template-columns:repeat(auto-fill,minmax(260px,1fr));gap:.6rem}
.plot svg{width:100%;display:block}.plot text{font-size:10px;fill:#4a5360}
table{border-collapse:collapse;width:100%;font-size:.85rem}th,td{text-align:left;vertical-align:top;
padding:.22rem .6rem .22rem 0;border-bottom:1px solid #e8eaed}td.bar{width:30%}
.stages td,.stages th{overflow-wrap:normal}.bar i{display:block;height:.7em;
margin-top:.3em;background:#286e96;border-radius:2px}
.plan{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(320px,100%),1fr));gap:1rem;align-items:start}
.flow svg{width:100%;max-width:480px;display:block}.flow text{font-size:11px;fill:#4a5360}.flow .name{fill:#1d2430}
.faint{opacity:.5}.arc path{fill:none;stroke:currentColor;stroke-width:1.2;opacity:.55}.arc .tip{fill:currentColor;
stroke:none}.arc:hover path{opacity:1;stroke-width:2.5}
pre{background:#20262e;color:#eef;padding:.5rem .7rem;border-radius:5px;white-space:pre-wrap;font-size:.82rem}
summary{cursor:pointer;font-weight:bold;font-size:.95rem;margin-top:.8rem}.bad{color:#c92a2a}
@keyframes play{to{transform:translateY(-100%)}}
@media (prefers-reduced-motion:reduce){.plays img{animation:none!important}}
"""
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
"""What a browser may load for the page: its own pictures and styles; no name or sentence can ask for more."""


def page(title: str, told: Sequence[Account], versions: dict[str, str]) -> str:
    """The page's text: all sequences at a glance, then each with what became of it."""
    counted = Counter(a.state for a in told)
    said = {"warnings": "with warnings"}
    states = ", ".join(f"{counted[s]} {said.get(s, s)}" for s in COLORS if counted[s])
    parts = [
        '<!doctype html><html lang="en"><head><meta charset="utf-8">',
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">',
        '<meta name="viewport" content="width=device-width,initial-scale=1">',
        f"<title>{escape(title)}: report</title><style>{STYLE}</style></head><body>",
        f"<h1>{escape(title)}</h1><p>{number(len(told), 'sequence')}: {states}.</p>",
        '<div class="grid">' + "".join(_card(i, a) for i, a in enumerate(told)) + "</div>",
        *(_section(i, a) for i, a in enumerate(told)),
        "<section><h2>Versions</h2><p>This page was written with:</p>",
        _pairs(versions),
        "</section></body></html>\n",
    ]
    return "\n".join(parts)


def _plays(strip: Drawn) -> str:
    steps = f"animation:play {strip.frames * FRAME_SECONDS:.2f}s steps({strip.frames}) infinite"
    return (
        f'<span class="plays" style="width:{strip.width}px;aspect-ratio:{strip.width}/{strip.height}">'
        f'<img alt="{escape(strip.caption, quote=True)}" src="{strip.uri}" style="{steps}"></span>'
    )


def _mark(state: str) -> str:
    return f'<span class="mark" style="background:{COLORS[state]}">{state}</span>'


def _strip(account: Account) -> str:
    """What plays of a sequence."""
    strips = [p for p in account.pictures if p.kind == "strip"]
    lacks = "made with other settings" if account.made_otherwise else "no picture"
    return _plays(strips[0]) if strips else f'<span class="none">{lacks}</span>'


def _card(index: int, account: Account) -> str:
    return f'<a class="card" href="#s{index}">{_strip(account)}<b>{escape(account.name)}</b>{_mark(account.state)}</a>'


def _section(index: int, account: Account) -> str:
    body = [f'<section id="s{index}"><h2>{escape(account.name)} {_mark(account.state)}</h2>']
    if account.refused:
        return "".join([*body, f'<p class="bad">{escape(account.refused)}</p></section>'])
    body += [
        f"<p>{escape(account.about)}</p>",
        *(f"<p><b>{escape(sentence)}</b></p>" for sentence in account.made_otherwise),
        _listed("Failures", account.failures, "bad"),
        "".join(f"<pre>{escape(command)}</pre>" for command in account.retry),
        _listed("Warnings", account.warnings),
        _shown(account),
        _plots(account),
        _changes(account),
        _stages(account),
        _folded("Settings that differ from the default", _settings(account)),
        _folded("Versions it was made with", _pairs(account.libraries)),
        "</section>",
    ]
    return "".join(body)


def _listed(title: str, sentences: Sequence[str], kind: str = "") -> str:
    return f'<h3 class="{kind}">{title}</h3>{_list(sentences)}' if sentences else ""


def _list(sentences: Sequence[str]) -> str:
    return "<ul>" + "".join(f"<li>{escape(s)}</li>" for s in sentences) + "</ul>" if sentences else ""


def _folded(title: str, content: str) -> str:
    """What is opened by whoever wants it; nothing where there is nothing."""
    return f"<details><summary>{title}</summary>{content}</details>" if content else ""


def _shown(account: Account) -> str:
    """Pairs and the sheet; the strip is on the card, its bytes are there once."""
    figures = _figures(account, ("pair", "sheet"))
    return f"<h3>Pictures</h3>{figures}" if figures else ""


def _figures(account: Account, kinds: Sequence[str]) -> str:
    """Pictures of some kinds side by side, each with its caption."""
    figures = [
        f'<figure><img alt="{escape(p.caption, quote=True)}" src="{p.uri}" width="{p.width}">'
        f"<figcaption>{escape(p.caption)}</figcaption></figure>"
        for p in account.pictures
        if p.kind in kinds
    ]
    return f'<div class="row">{"".join(figures)}</div>' if figures else ""


def _changes(account: Account) -> str:
    """What effects change as pictures, then every reason."""
    figures = _figures(account, ("change",))
    names = ", ".join(account.unseen)
    unseen = f"<p>On, but the archive holds nothing made without them to compare with: {escape(names)}.</p>"
    reasons = _folded("Effects and choices, with their reasons", _list(account.effects))
    if not figures and not names:
        return reasons
    return f"<h3>What effects and choices change</h3>{figures}{unseen if names else ''}{reasons}"


def _plots(account: Account) -> str:
    drawn = "".join(plot(measure, cameras) for measure, cameras in account.measures.items())
    return f'<h3>Measures over time</h3><div class="plots">{drawn}</div>' if drawn else ""


def _stages(account: Account) -> str:
    """What is done of every stage, and where the seconds went."""
    dearest = max(account.seconds.values(), default=0.0)
    rows = ""
    for stage, counted in account.stages.items():
        if not counted:
            continue
        spent = account.seconds.get(stage)
        others = ", ".join(f"{n} {word}" for word, n in counted.items() if n and word not in ("all", "done"))
        share = 100 * spent / dearest if spent and dearest else 0
        bar = f'<i style="width:{share:.0f}%"></i>' if share else ""
        rows += (
            f"<tr><td>{escape(stage)}</td><td>{counted['done']} of {counted['all']}</td><td>{others}</td>"
            f'<td>{seconds_text(spent) if spent is not None else ""}</td><td class="bar">{bar}</td></tr>'
        )
    if not rows:
        return ""
    head = "<tr><th>stage</th><th>tasks done</th><th>others</th><th>seconds</th><th></th></tr>"
    failed = {stage for stage, counted in account.stages.items() if counted.get("failed")}
    return (
        f'<h3>The plan, and where the seconds went</h3><div class="plan">{flow(account.plan, account.seconds, failed)}'
        f'<table class="stages">{head}{rows}</table></div>'
    )


def _settings(account: Account) -> str:
    if not account.settings:
        return ""
    rows = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in account.settings)
    return f"<table><tr><th>setting</th><th>here</th><th>default</th></tr>{rows}</table>"


def _pairs(values: dict[str, str]) -> str:
    return f"<p>{escape(', '.join(f'{name} {value}' for name, value in values.items()))}</p>" if values else ""
