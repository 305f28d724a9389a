"""Tables of pushes for tests: a small valid one, and its files as text."""

from collections.abc import Mapping, Sequence
from pathlib import Path

BOX = ((0.05, 0.03), (-0.05, 0.03), (-0.05, -0.03), (0.05, -0.03))
PUSH: Mapping[str, object] = {
    "object": "box",
    "pusher_x_m": -0.06,
    "pusher_y_m": 0.01,
    "push_angle_rad": 0.0,
    "push_length_m": 0.05,
    "object_x_m": 0.04,
    "object_y_m": 0.001,
    "object_yaw_rad": -0.3,
}


def csv_text(rows: Sequence[Mapping[str, object]]) -> str:
    """Return rows as CSV, with the columns of the first row."""
    names = list(rows[0])
    return "\n".join([",".join(names), *(",".join(str(row[name]) for name in names) for row in rows)]) + "\n"


def corner_rows(name: str = "box", corners: Sequence[tuple[float, float]] = BOX) -> list[dict[str, object]]:
    """Return the rows of one object."""
    return [{"object": name, "corner": number, "x_m": x, "y_m": y} for number, (x, y) in enumerate(corners)]


def write_folder(
    folder: Path,
    pushes: Sequence[Mapping[str, object]] = (PUSH,),
    corners: Sequence[Mapping[str, object]] | None = None,
) -> Path:
    """Write a table as CSV files and return the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "pushes.csv").write_text(csv_text(pushes))
    (folder / "objects.csv").write_text(csv_text(corners or corner_rows()))
    return folder
