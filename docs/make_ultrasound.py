"""Put measured tables into docs/measured.md: python docs/make_ultrasound.py NAME=DIR …

Each folder is what `python -m bench ultrasound 4.1 4.2 sweep -o DIR --json > DIR/bench.json` left:
its tables 4.1 and 4.2 become one, its table of a sweep another, under the device's name. They
replace what stands between <!-- NAME --> and <!-- /NAME -->; names are cpu and gpu.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

PAGE = Path(__file__).with_name("measured.md")
METHODS = ("pvn-om", "vvn-om", "pvn", "vvn")


def main(folders: list[str]) -> None:
    text = PAGE.read_text()
    for word in folders:
        name, _, folder = word.partition("=")
        tables = json.loads((Path(folder) / "bench.json").read_text())
        head, rest = text.split(f"<!-- {name} -->")
        tail = rest.split(f"<!-- /{name} -->")[1]
        text = f"{head}<!-- {name} -->\n{section(tables, name == 'cpu')}<!-- /{name} -->{tail}"
    PAGE.write_text(text)


def section(tables: dict, cores: bool) -> str:
    """cores: seconds of all threads together, which other work does not lengthen."""
    lines = []
    if "4.1" in tables:
        device = tables["4.1"]["notes"][0].split("ours: ")[1]
        memory = {key(row): row for row in rows(tables.get("4.2"))}
        unit = "core s" if cores else "s"
        names = ["frames", "volume", *(f"{m.upper()} {unit}" for m in METHODS)]
        names += [] if cores else ["PVN-OM on device s"]
        names += ["PVN-OM MiB", "VVN-OM MiB"]
        lines += [f"**{device}**", "", f"| {' | '.join(names)} |", "|" + "---|" * len(names)]
        found = {key(row): row for row in rows(tables["4.1"])}
        for frames, size in dict.fromkeys(k[:2] for k in found):
            mine = [found[frames, size, method] for method in METHODS]
            if cores:
                cells = [both(row | {"ours s": row["core s"]}, "s") for row in mine]
            else:
                cells = [both(row, "s") for row in mine] + [number(mine[0]["on device s"])]
            cells += [both(memory.get((frames, size, m)), "MiB") for m in METHODS[:2]]
            lines.append(f"| {frames} | {size}³ | " + " | ".join(cells) + " |")
        lines.append("")
    if "sweep" in tables:
        table = tables["sweep"]
        lines += [f"{table['title']}; {'; '.join(table['notes'])}:", ""]
        lines += ["| " + " | ".join(table["columns"]) + " |", "|" + "---|" * len(table["columns"])]
        lines += ["| " + " | ".join(map(number, row)) + " |" for row in table["rows"]]
        lines.append("")
    return "\n".join(lines) + "\n"


def rows(table: dict | None) -> list[dict]:
    return [dict(zip(table["columns"], row, strict=True)) for row in table["rows"]] if table else []


def key(row: dict) -> tuple:
    return row["frames"], row["size"], row["method"]


def both(row: dict | None, unit: str) -> str:
    """Source → ours."""
    if row is None:
        return "–"
    source, ours = row[f"source {unit}"], row[f"ours {unit}"]
    return number(ours) if source is None else f"{number(source)} → {number(ours)}"


def number(value: object) -> str:
    if value is None:
        return "–"
    if not isinstance(value, float):
        return str(value)
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.3g}"


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    main(sys.argv[1:])
