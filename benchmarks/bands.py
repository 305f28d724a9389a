"""Coverage by band of the models of Omnipush's objects, and the share of unfamiliar queries that they find.

    python -m benchmarks.bands runs/push-indicator runs/push-none runs/push-visual [--data FOLDER] [--views FOLDER]
        [--registry models] [--out docs/results/bands]

Each RUN holds objects out. Its predictions of them are calibrated as for publication, and shown by ring of starts and
band of aims, beside those of the last version that learnt a ring of starts only, on the same pushes. Then the domain of
the run's training objects is asked about queries inside (pushes and views of the held-out objects) and outside of it
(starts too near and too far, objects with more weights, pictures of other things). With --out the page is written to a
folder, with the figures of the goals beside it.
"""

import argparse
import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import numpy as np
import torch
from PIL import Image, ImageDraw
from torch import Tensor

from service.model.predictor import OnnxPredictor
from service.model.tensors import ContextKind
from service.pushing.contexts import SHAPE_DIGITS, VISUAL_SIZE, WEIGHT_LETTERS, ObjectContext
from service.pushing.images import FIELD_OF_VIEW_M, GreyImage, visual_context
from service.registry.loading import load_version
from service.registry.registry import Registry
from training.fitting.bands import CAMERA, LEVEL, bands, calibrated, held_out_views
from training.fitting.evaluation import Predictions, joined
from training.fitting.recipe import Recipe
from training.fitting.run_folder import load_run
from training.fitting.samples import Samples, read_pushes
from training.networks.omnipush_domain import OmnipushDomain
from training.networks.push_network import PushNetwork
from training.omnipush.layout import DEFAULT_DATA
from training.omnipush.pushes import Pushes
from training.omnipush.views import VIEW_PIXELS, View
from training.publishing.publish import domain_of
from training.publishing.rivals import predicted
from training.shapes.families import FAMILIES
from training.shapes.outlines import draw_outline
from training.simulation.camera import camera_view
from training.simulation.drawing import top_down_view

QUERIES: Final = 96  # of each kind
BODY_LEVEL: Final = 128
SIZES_M: Final = (0.025, 0.060)  # root mean square radius of other things: about those of Omnipush's objects
RIVALS: Final = {"push-indicator": 2, "push-none": 1, "push-visual": 1}  # trained on a ring
Rows = list[tuple[str, int, float]]  # a kind of query, their number, and the share that is called unfamiliar


def coverage_rows(name: str, found: Predictions) -> list[str]:
    """Return rows of a table: the figures of all pushes, then of each band."""
    whole = [("all pushes", len(found.mean), found.measures())]
    each = whole + [(band.name(), band.pushes, band.found) for band in bands(found)]
    return [
        f"| {name} | {band} | {pushes} | {figures.rmse:.4f} | {figures.nll:.2f} | "
        + " | ".join(f"{100 * share:.1f}" for share in figures.coverage.values())
        + " |"
        for band, pushes, figures in each
    ]


def summary(name: str, found: dict[str, Predictions]) -> dict[str, float]:
    """Return the figures of a model's goals: the least and most that 90 % intervals hold in a band, in per cent.

    For a model of views also its RMSE on camera views over that on drawings.
    """
    shares = [100.0 * band.found.coverage[LEVEL] for each in found.values() for band in bands(each)]
    figures = {f"{name}_low": min(shares), f"{name}_high": max(shares)}
    if CAMERA in found:
        figures["camera"] = found[CAMERA].measures().rmse / found[""].measures().rmse
    return figures


def rival(registry: Registry, name: str, samples: Samples) -> dict[str, Predictions]:
    """Return the predictions of the version before, on the same pushes and views."""
    predictor = load_version(registry, OnnxPredictor, name, RIVALS[name]).predictor
    return {
        views: joined([predicted(predictor, seen) for seen in each]) for views, each in held_out_views(samples).items()
    }


def share_outside(distances: Tensor) -> float:
    """Return the share of distances above 1."""
    return float((distances > 1.0).double().mean())


def push_queries(domain: OmnipushDomain, held_out: Pushes) -> Rows:
    """Ask about the starts of held-out pushes, and about starts too near and too far."""
    rng = np.random.default_rng(0)
    inside = torch.from_numpy(held_out.pushers[held_out.valid > 0])

    def starts(low_m: float, high_m: float) -> Tensor:
        """Draw pushes that start between two distances and head anywhere."""
        distance, bearing = rng.uniform(low_m, high_m, QUERIES), rng.uniform(-np.pi, np.pi, QUERIES)
        columns = distance * np.cos(bearing), distance * np.sin(bearing), rng.uniform(-np.pi, np.pi, QUERIES)
        return torch.from_numpy(np.column_stack(columns).astype(np.float32))

    kinds = {
        "inside: pushes of held-out objects": inside,
        "starts 0 to 45 mm from the centre": starts(0.0, 0.045),
        "starts 126 to 200 mm from the centre": starts(0.126, 0.2),
        "starts 200 mm to 1 m from the centre": starts(0.2, 1.0),
    }
    return [(kind, len(asked), share_outside(domain.pushes_of(asked))) for kind, asked in kinds.items()]


def indicator_queries(domain: OmnipushDomain, held_out: Pushes) -> Rows:
    """Ask about held-out objects, and about objects with three and four weights."""
    rng = np.random.default_rng(1)

    def weighted(count: int) -> ObjectContext:
        """Draw an object with so many weights."""
        heavy = rng.permutation(4) < count
        sides = (
            rng.choice(list(SHAPE_DIGITS)) + (rng.choice(list(WEIGHT_LETTERS[1:3])) if on else "a") for on in heavy
        )
        return ObjectContext.from_descriptor("".join(sides))

    rows = [("inside: held-out objects", len(held_out.descriptors), torch.from_numpy(held_out.indicators))]
    for count in (3, 4):
        drawn = np.stack([weighted(count).indicator() for _ in range(QUERIES)])
        rows.append((f"objects with {count} weights", QUERIES, torch.from_numpy(drawn)))
    return [(kind, number, share_outside(domain.objects_of(asked))) for kind, number, asked in rows]


def thing(rng: np.random.Generator) -> View:
    """Draw the view of an object of a random family, about as large as Omnipush's."""
    outline = draw_outline(str(rng.choice(list(FAMILIES))), rng)
    corners = (outline.corners - outline.centroid_m) * (rng.uniform(*SIZES_M) / outline.size_m)
    pixels = VIEW_PIXELS / 2 + corners * [1.0, -1.0] * VIEW_PIXELS / FIELD_OF_VIEW_M
    image = Image.new("L", (VIEW_PIXELS, VIEW_PIXELS))
    ImageDraw.Draw(image).polygon([tuple(place) for place in pixels.tolist()], fill=BODY_LEVEL)
    return np.array(image)


def changed(view: View, angle_deg: float = 0.0, scale: float = 1.0) -> View:
    """Return a view turned about its middle, and scaled."""
    size = round(VIEW_PIXELS * scale)
    image = Image.new("L", (VIEW_PIXELS, VIEW_PIXELS))
    image.paste(Image.fromarray(view).rotate(angle_deg).resize((size, size)), ((VIEW_PIXELS - size) // 2,) * 2)
    return np.array(image)


def view_queries(domain: OmnipushDomain, held_out: Pushes) -> Iterator[tuple[str, int, float]]:
    """Ask about views of held-out objects, and about pictures of other things, drawn and as a camera sees them."""
    rng = np.random.default_rng(2)
    drawings = [top_down_view(ObjectContext.from_descriptor(name)) for name in held_out.descriptors]
    for kind, levels in (("drawings", held_out.views), ("camera views", held_out.camera_views)):
        if levels is None:
            continue
        asked = torch.from_numpy(levels.reshape(-1, 1, VISUAL_SIZE, VISUAL_SIZE) / np.float32(255.0))
        yield f"inside: {kind} of held-out objects", len(asked), share_outside(domain.objects_of(asked))
    others: dict[str, Callable[[], View]] = {
        "other things, 24 families": lambda: thing(rng),
        "an empty table": lambda: np.zeros((VIEW_PIXELS, VIEW_PIXELS), dtype=np.uint8),
        "Omnipush's, turned by 15 to 75 degrees": lambda: changed(_any(drawings, rng), rng.uniform(15.0, 75.0)),
        "Omnipush's, 0.5 to 0.8 of the scale": lambda: changed(_any(drawings, rng), scale=rng.uniform(0.5, 0.8)),
        "Omnipush's, 1.2 to 1.5 of the scale": lambda: changed(_any(drawings, rng), scale=rng.uniform(1.2, 1.5)),
        "Omnipush's, 15 to 40 mm off the middle": lambda: np.roll(_any(drawings, rng), int(rng.integers(45, 120)), 1),
        "Omnipush's, dark on light": lambda: 255 - _any(drawings, rng),
    }
    for kind, draw in others.items():
        views = [draw() for _ in range(QUERIES)]
        for suffix, seen in (("drawn", views), ("camera", [camera_view(view, rng) for view in views])):
            contexts = b"".join(visual_context(GreyImage.from_array(view, kind)).levels for view in seen)
            context = np.frombuffer(contexts, dtype=np.uint8).reshape(-1, 1, VISUAL_SIZE, VISUAL_SIZE)
            asked = torch.from_numpy(context / np.float32(255.0))
            yield f"{kind}, {suffix}", len(asked), share_outside(domain.objects_of(asked))


def _any(drawings: list[View], rng: np.random.Generator) -> View:
    return drawings[int(rng.integers(len(drawings)))]


def page(runs: list[Path], folder: Path, views: Path | None, registry: Registry) -> tuple[str, dict[str, float]]:
    """Return the page and the figures of the goals.

    The page has coverage by band of each run, then the queries inside and outside of its domain.
    """
    coverage, unfamiliar, source, goals = [], [], "", dict[str, float]()
    for run in runs:
        recipe, network, _ = load_run(run)
        if not isinstance(network, PushNetwork):
            raise SystemExit(f"{run} is not a run of a served method; name a run of push-indicator, -none or -visual")
        pushes = read_pushes(folder, recipe.context_kind, views, recipe.camera_views)
        source, split = pushes.source, recipe.split()
        held_out = pushes.select(split.test)
        samples = Samples.of(held_out, recipe.context_kind)
        for kind, found in rival(registry, recipe.name, samples).items():
            coverage += coverage_rows(f"{recipe.name} {RIVALS[recipe.name]} {kind}".strip(), found)
        new = calibrated(network, samples).predictions
        goals |= summary(recipe.name, new)
        for kind, found in new.items():
            coverage += coverage_rows(f"**{recipe.name} {RIVALS[recipe.name] + 1}** {kind}".strip(), found)
        domain = domain_of(pushes.select(split.train), recipe.context_kind)
        unfamiliar += [
            f"| {recipe.name} | {kind} | {n} | {100 * share:.1f} |"
            for kind, n, share in _asked(recipe, domain, held_out)
        ]
    return _PAGE.format(source=source, coverage="\n".join(coverage), unfamiliar="\n".join(unfamiliar)), goals


def _asked(recipe: Recipe, domain: OmnipushDomain, held_out: Pushes) -> Rows:
    rows = push_queries(domain, held_out)
    if recipe.context_kind is ContextKind.INDICATOR:
        rows += indicator_queries(domain, held_out)
    if recipe.context_kind is ContextKind.VISUAL:
        rows += view_queries(domain, held_out)
    return rows


_PAGE: Final = """# Bands: where the models of Omnipush's objects are right about themselves

Written by `python -m benchmarks.bands`, see [benchmarks](../../../benchmarks/README.md), from
{source}.

Figures are of the 50 held-out objects of `different-objects`. The published versions (in bold) learnt all 250 objects,
so these are of the same recipe, trained on the other 200 and calibrated: each half of the 50 with the factor of the
other half. The versions before learnt a ring of starts, 75 to 85 mm from the centre with aims within 24 mm, in the
simulation of their day, of all 250 objects. `camera` is the same pushes with four camera views of each object.

Start is the distance of the tip from the object's centre, aim the distance of the push's line from it.

| model | pushes | number | RMSE | NLL | 50 % hold | 90 % hold | 95 % hold |
|---|---|---|---|---|---|---|---|
{coverage}

## Unfamiliar queries

The share of queries that the domain of each new version calls unfamiliar, in per cent: at most 2 inside, 95 or more
outside. Camera views have light, shadow, blur, noise and small errors of place.

| model | queries | number | unfamiliar |
|---|---|---|---|
{unfamiliar}
"""


def main(arguments: list[str]) -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path, nargs="+", metavar="RUN")
    parser.add_argument("--data", type=Path, default=DEFAULT_DATA)
    parser.add_argument("--views", type=Path)
    parser.add_argument("--registry", type=Path, default=Path("models"))
    parser.add_argument("--out", type=Path)
    options = parser.parse_args(arguments)
    text, goals = page(options.runs, options.data, options.views, Registry(options.registry))
    print(text)
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
        (options.out / "README.md").write_text(text, encoding="utf-8")
        rounded = {name: round(figure, 4) for name, figure in goals.items()}
        (options.out / "figures.json").write_text(json.dumps({"summary": rounded}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
