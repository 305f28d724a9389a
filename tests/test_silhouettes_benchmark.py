"""Benchmark of outlines in pictures: pictures are judged, figures counted, and the page and examples written."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks import silhouettes
from benchmarks.photographs import rendered_mask
from benchmarks.silhouettes import EXAMPLES_FILE, FIGURES_FILE, PAGE_FILE, Result, main, overlap, summary
from benchmarks.silhouettes_cost import Cost

SQUARE = np.array([(10.0, 10.0), (30.0, 10.0), (30.0, 30.0), (10.0, 30.0)])


def test_the_overlap_of_outlines_is_that_of_their_areas() -> None:
    """A square with itself has 1, moved by half its width 1/3, and without an outline 0."""
    mask = rendered_mask(SQUARE, (64, 48)) >= 0.5
    assert overlap(SQUARE, mask) == 1.0
    assert overlap(SQUARE + np.array([10.0, 0.0]), mask) == pytest.approx(1.0 / 3.0)
    assert overlap(None, mask) == 0.0


def test_mistakes_and_refusals_are_counted_apart() -> None:
    """Of four photographs one is right, one a mistake, one a grave mistake and one refused."""
    ones = [(0.95, ""), (0.85, ""), (0.1, ""), (0.0, "image_blank")]
    results = [Result("one object", number, *one, 0.5, None) for number, one in enumerate(ones)]
    results += [Result("clipped", 0, 0.0, "image_clipped", 1.0, None), Result("clipped", 1, 0.4, "", 1.0, None)]
    figures = summary(results, [0.99, 0.98])
    expected = {"count": 4, "good": 25.0, "mistakes": 50.0, "grave_mistakes": 25.0, "mask_least_overlap": 0.98}
    assert {key: figures[key] for key in expected} == expected
    assert figures["false_refusals"] == {"image_blank": 25.0}
    others = figures["others"]
    assert isinstance(others, dict)
    assert others["clipped"] == {"count": 2, "refused": 50.0, "codes": {"image_clipped": 1, "answered": 1}}


def test_a_page_is_written_with_examples(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A photograph gives a page with every condition, figures as JSON, and a picture."""
    monkeypatch.setattr(silhouettes, "costs", lambda: [Cost("a mask", 0.1, 0.2, 30.0, "4 corners")])
    main(["--count", "1", "--jobs", "1", "--out", str(tmp_path)])
    assert f"look at {tmp_path / EXAMPLES_FILE}" in capsys.readouterr().out
    figures = json.loads((tmp_path / FIGURES_FILE).read_text())
    assert figures["count"] == 1
    assert figures["costs"][0]["memory_mib"] == 30.0
    page = (tmp_path / PAGE_FILE).read_text()
    assert f"{figures['good']:.1f} %" in page
    assert "| a mask | 0.10 s | 0.20 s | 30 MiB | 4 corners |" in page
    with Image.open(tmp_path / EXAMPLES_FILE) as sheet:
        assert np.asarray(sheet.convert("L")).std() > 10.0
