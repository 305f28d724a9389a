"""Page of warnings: shares by code and model, and by kind of query."""

from collections.abc import Mapping
from typing import Any, Final

CAUGHT, FALSE_ALARMS = 95.0, 2.0  # percent: the goals
PAGE: Final = """# Warnings inside and outside of the domains

`{command} --out docs/results/warnings`

Goals: of the queries outside at least {caught:.0f} % are caught, of those inside at most {alarms:.0f} % have a false
alarm, for every code and champion. The least share caught is **{least:.1f} %**, the largest share of false alarms
**{most:.1f} %**.

## By code and model

| code | model | outside | caught | inside | false alarms |
|---|---|---|---|---|---|
{codes}

## Queries inside

Held-out pushes and objects like those of training, drawn anew (seed {seed}). Near misses, within 2 mm, are left out.
Numbers are shares of the queries with each code.

| model | queries | count | due | codes |
|---|---|---|---|---|
{inside}

## Queries outside

One fault each. A query is caught if one of the codes that are due comes with its answer, or if it is refused.

| model | queries | count | due | caught | refused | codes |
|---|---|---|---|---|---|---|
{outside}

Not counted are objects of Omnipush whose weights or shapes are sent wrongly: they are known objects, only others. An
angle in degrees between -6 and 6 cannot be told from one in rad, which is 3.6 % of all whole degrees.
"""


def page(figures: Mapping[str, Any]) -> str:
    """Return the page in Markdown, of the document of figures."""
    return PAGE.format(
        command=figures["command"],
        seed=figures["seed"],
        caught=CAUGHT,
        alarms=FALSE_ALARMS,
        least=figures["least_caught"],
        most=figures["most_false_alarms"],
        codes="\n".join(_by_code(row) for row in figures["by_code"]),
        inside="\n".join(_inside(row) for row in figures["kinds"] if row["inside"]),
        outside="\n".join(_outside(row) for row in figures["kinds"] if not row["inside"]),
    )


def _by_code(row: Mapping[str, Any]) -> str:
    caught = _judged(row["caught"], row["caught"] >= CAUGHT)
    alarms = _judged(row["false_alarms"], row["false_alarms"] <= FALSE_ALARMS)
    return f"| `{row['code']}` | {row['model']} | {row['outside']} | {caught} | {row['inside']} | {alarms} |"


def _judged(share: float, reached: bool) -> str:
    return f"{share:.1f} %" if reached else f"**{share:.1f} %** (missed)"


def _inside(row: Mapping[str, Any]) -> str:
    return f"| {row['model']} | {row['name']} | {row['count']} | {_codes(row['due'])} | {_shares(row)} |"


def _outside(row: Mapping[str, Any]) -> str:
    caught, refused = (f"{100.0 * row[name] / max(1, row['count']):.1f} %" for name in ("caught", "refused"))
    due = _codes(row["due"])
    return f"| {row['model']} | {row['name']} | {row['count']} | {due} | {caught} | {refused} | {_shares(row)} |"


def _codes(codes: list[str]) -> str:
    return ", ".join(f"`{code}`" for code in codes)


def _shares(row: Mapping[str, Any]) -> str:
    many = max(1, row["count"])
    shares = [f"`{code}` {100.0 * number / many:.1f} %" for code, number in row["codes"].items()]
    if row["refused"]:
        shares.append(f"refused {100.0 * row['refused'] / many:.1f} %")
    return ", ".join(shares)
