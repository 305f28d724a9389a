"""Predictions of a table of pushes: nothing moves, mechanics, the simulation, published models, and peers.

Models of any shape are asked in the frame of the table. Omnipush's models put the origin at the object's centre, so a
table's frame is shifted to the centroid for them, and their answers are shifted back, spreads included. They know
pushes of 50 mm by a tip of 4.75 mm. Other pushes are left out for them, and a note says so.
"""

import io
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
from PIL import Image
from tqdm import tqdm

from benchmarks.shape_predictions import Knowledge, ask_shapes, starts_outside
from service.client import Client
from service.client.arguments import Context
from service.errors import DataError
from service.pushing import mechanics
from service.pushing.first_contact import first_contact
from service.pushing.images import BODY_LEVEL, FIELD_OF_VIEW_M
from service.pushing.outlines import Outline
from service.pushing.poses import PUSH_LENGTH_M, REACH_M, DoubleArray, wrap_angles
from service.schemas.contexts import ContextBody
from training.omnipush.views import VIEW_PIXELS
from training.simulation.bodies import RECORDED
from training.simulation.replay import replay
from training.tables.push_table import DEFAULT_PUSHER_RADIUS_M, PushTable

NOTHING: Final = "nothing moves"
MECHANICS: Final = "mechanics"
SIMULATION: Final = "simulation"
MOVED_M: Final = 0.002
DOUBTFUL: Final = 0.05  # share of pushes that move an object without meeting it
LEAST_STD: Final = (1e-4, 1e-4, math.radians(0.1))  # m, m, rad: of a push that all draws miss
BATCH: Final = 10_000  # pushes that the service answers at once
TILE_PIXELS: Final = 37  # side of the tiles of a view, of which only those on the boundary are drawn pixel by pixel
KNOWN_WITHIN_M: Final = 0.001  # of length and tip: Omnipush's models are asked for no other push
ASKED_AS: Final = {
    "none": "the push alone",
    "visual": "a view drawn from the outline",
    "shape": Knowledge.BODY.value,
}


@dataclass(frozen=True)
class Predicted:
    """Predictions of one model for n pushes of a table, in its frame.

    Attributes:
        name: the model.
        knows: the model's knowledge of an object.
        mean: (n, 3).
        covariance: (n, 3, 3), or None for a model without spread.
        rows: (n,) true for the pushes that the model answers. The others hold zeros.
        notes: sentences about the pushes that were left out, and about pictures.
    """

    name: str
    knows: str
    mean: DoubleArray
    covariance: DoubleArray | None
    rows: npt.NDArray[np.bool_]
    notes: tuple[str, ...] = ()


def predicted_without_model(table: PushTable, wanted: Callable[[str], bool], draws: int) -> Iterator[Predicted]:
    """Yield the chosen predictions that need no model: nothing moves, mechanics, the simulation, and peers.

    Args:
        table: the pushes.
        wanted: the choice, by name.
        draws: simulations of every push.
    """
    everywhere = np.ones(table.count, dtype=np.bool_)
    knows = "outline"
    if any(item.centre_of_mass_m or item.friction is not None for item in table.objects):
        knows = "outline; centre of mass and friction where the table has them"
    if wanted(NOTHING):
        yield Predicted(NOTHING, "-", np.zeros((table.count, 3)), None, everywhere)
    if wanted(MECHANICS):
        yield Predicted(MECHANICS, knows, quasi_static(table), None, everywhere)
    if wanted(SIMULATION):
        notes = (
            f"{SIMULATION}: mean and scatter of {draws} draws of friction, pressure and tracker for every push. Its "
            "constants, one set for all, were chosen by recorded pushes of seven steel shapes (docs/results/scene). On "
            "those it is no blind test.",
        )
        plates = {name for name, _ in RECORDED.plates} & set(table.surfaces)
        surface = "; surface" if plates else ""
        yield Predicted(SIMULATION, f"{knows}{surface}", *simulated(table, draws), everywhere, notes)
    for name in filter(wanted, table.peers):
        yield Predicted(name, "a peer's column of the table", table.peers[name], None, everywhere)


def quasi_static(table: PushTable) -> DoubleArray:
    """Return the outcomes (n, 3) of quasi-static mechanics, with the table's centres of mass and friction."""
    found = np.zeros((table.count, 3))
    with tqdm(total=table.count, desc=MECHANICS, unit="push", disable=None) as bar:
        for number, item in enumerate(table.objects):
            rows = table.object_index == number
            friction = mechanics.FRICTION if item.friction is None else item.friction
            found[rows] = mechanics.push(
                item.outline, table.pushers[rows], table.pusher_radius_m[rows], friction, item.centre_of_mass_m
            )
            bar.update(int(rows.sum()))
    return found


def simulated(table: PushTable, draws: int) -> tuple[DoubleArray, DoubleArray]:
    """Return means (n, 3) and covariances (n, 3, 3) of the outcomes of repeated simulations.

    The spread is that of a further draw, given so few of them, and not below the tracker's noise.
    """
    found = np.empty((draws, table.count, 3))
    with tqdm(total=table.count, desc=SIMULATION, unit="push", disable=None) as bar:
        for number in range(len(table.objects)):
            rows = np.flatnonzero(table.object_index == number)
            found[:, rows] = replay(table.select(rows), 0, draws)
            bar.update(len(rows))
    found[..., 2] = found[0, :, 2] + wrap_angles(found[..., 2] - found[0, :, 2])
    std = np.maximum(found.std(axis=0, ddof=1) * math.sqrt(1.0 + 1.0 / draws), LEAST_STD)
    return found.mean(axis=0), np.einsum("ni,ij->nij", std**2, np.eye(3))


def predicted_by_models(
    table: PushTable, folder: Path, wanted: Callable[[str], bool], notes: list[str]
) -> Iterator[Predicted]:
    """Yield the predictions of every published version of a registry that can take the table's objects.

    Args:
        table: the pushes.
        folder: the registry.
        wanted: the choice of versions, by ``name@version``.
        notes: filled with a sentence about each model that cannot take an outline.

    Raises:
        RegistryError: the registry cannot be read.
        ModelNotReadyError: no model in it can be loaded.
    """
    with Client.local(str(folder)) as client:
        views: list[Context] = []
        for model in client.list_models().models:
            versions = [version for version in model.versions if wanted(f"{model.name}@{version}")]
            if not versions:
                continue
            if model.context_kind not in ASKED_AS:
                notes.append(
                    f"{model.name} is not asked: its context is of kind {model.context_kind}, which no outline gives."
                )
                continue
            if model.context_kind == "visual" and not views:
                views = list(_views(table, client))
            for version in versions:
                if model.context_kind == "shape":
                    yield _answer_shapes(table, client, f"{model.name}@{version}")
                    continue
                contexts = views if model.context_kind == "visual" else []
                yield _answer(table, client, f"{model.name}@{version}", model.context_kind, contexts)


def _answer_shapes(table: PushTable, client: Client, name: str) -> Predicted:
    """Ask a version of a model of any shape for every push that starts outside of its object."""
    known = starts_outside(table)
    mean, std = np.zeros((table.count, 3)), np.ones((table.count, 3))
    mean[known], std[known] = ask_shapes(client, name, table, np.flatnonzero(known), Knowledge.BODY)
    left = table.count - int(known.sum())
    notes = (
        (f"{name}: {left:,} of {table.count:,} pushes are left out: they start inside of their object.",)
        if left
        else ()
    )
    return Predicted(name, ASKED_AS["shape"], mean, np.einsum("ni,ij->nij", std**2, np.eye(3)), known, notes)


def _answer(table: PushTable, client: Client, name: str, kind: str, contexts: Sequence[Context]) -> Predicted:
    """Ask a version for every push of the kind that it knows."""
    centres = np.array([item.outline.centroid_m for item in table.objects])[table.object_index]
    pushers = table.pushers[:, :3] - np.column_stack([centres, np.zeros(table.count)])
    known = np.abs(table.pushers[:, 3] - PUSH_LENGTH_M) <= KNOWN_WITHIN_M
    known &= np.abs(table.pusher_radius_m - DEFAULT_PUSHER_RADIUS_M) <= KNOWN_WITHIN_M
    known &= (np.abs(pushers[:, :2]) <= REACH_M).all(axis=1)
    mean, std = np.zeros((table.count, 3)), np.ones((table.count, 3))
    rows = np.flatnonzero(known)
    for part in _parts(rows, name):
        index = table.object_index[part] if contexts else None
        found = client.predict_batch(pushers[part], list(contexts) or None, index, model=name)
        mean[part], std[part] = found.mean, found.std
    mean[known], covariance = _shifted_back(mean[known], std[known], centres[known])
    whole = np.tile(np.eye(3), (table.count, 1, 1))
    whole[known] = covariance
    notes = []
    if not known.all():
        notes.append(
            f"{name}: {table.count - len(rows)} pushes are left out, because it knows pushes of 50 mm by a tip of "
            "4.75 mm radius only, within 1 mm, that start within 1 m."
        )
    if contexts and (clipped := [item.name for item in table.objects if not _fits(item.outline)]):
        names = ", ".join(clipped[:8]) + (" ..." if len(clipped) > 8 else "")
        notes.append(f"{name}: its view of 160 mm does not hold the whole of {names}.")
    return Predicted(name, ASKED_AS[kind], mean, whole, known, tuple(notes))


def _shifted_back(mean: DoubleArray, std: DoubleArray, centres: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
    """Return predictions about centres as means (n, 3) and covariances (n, 3, 3) of the table's frame.

    The frame's origin moves to c + d - R(yaw) c, if the centre c moves by d.
    """
    cos, sin = np.cos(mean[:, 2]), np.sin(mean[:, 2])
    turned = np.column_stack([cos * centres[:, 0] - sin * centres[:, 1], sin * centres[:, 0] + cos * centres[:, 1]])
    shifted = mean.copy()
    shifted[:, :2] += centres - turned
    jacobian = np.tile(np.eye(3), (len(mean), 1, 1))
    jacobian[:, 0, 2], jacobian[:, 1, 2] = turned[:, 1], -turned[:, 0]
    return shifted, np.einsum("nij,nj,nkj->nik", jacobian, std**2, jacobian)


def _views(table: PushTable, client: Client) -> Iterator[ContextBody]:
    """Yield the visual context of each object, from a picture as a user of the service would send it."""
    for item in tqdm(table.objects, desc="views", unit="object", disable=None):
        content = io.BytesIO()
        Image.fromarray(view(item.outline)).save(content, "PNG")
        yield ContextBody(visual=client.make_context(content.getvalue()).visual)


def view(outline: Outline) -> npt.NDArray[np.uint8]:
    """Draw an outline about its centroid, uint8 [481, 481], by ``service.pushing.images.IMAGE_CONVENTION``."""
    pixel_m = FIELD_OF_VIEW_M / VIEW_PIXELS
    offset = (np.arange(VIEW_PIXELS) - VIEW_PIXELS // 2) * pixel_m
    tiles = VIEW_PIXELS // TILE_PIXELS
    middles = np.stack(np.meshgrid(offset, -offset), axis=-1) + outline.centroid_m
    middles = middles.reshape(tiles, TILE_PIXELS, tiles, TILE_PIXELS, 2).swapaxes(1, 2).reshape(tiles**2, -1, 2)
    distance = np.repeat(outline.distance_m(middles[:, middles.shape[1] // 2])[:, None], middles.shape[1], axis=1)
    near = np.abs(distance[:, 0]) < TILE_PIXELS * pixel_m  # the boundary may cross these tiles
    distance[near] = outline.distance_m(middles[near].reshape(-1, 2)).reshape(-1, middles.shape[1])
    covered = np.clip(0.5 - distance / pixel_m, 0.0, 1.0).reshape(tiles, tiles, TILE_PIXELS, TILE_PIXELS)
    levels = np.floor(covered.swapaxes(1, 2).reshape(VIEW_PIXELS, VIEW_PIXELS) * BODY_LEVEL * 255.0 + 0.5)
    return levels.astype(np.uint8)


def _fits(outline: Outline) -> bool:
    return bool(np.abs(outline.corners - outline.centroid_m).max() <= FIELD_OF_VIEW_M / 2.0)


def _parts(rows: npt.NDArray[np.int64], name: str) -> Iterable[npt.NDArray[np.int64]]:
    with tqdm(total=len(rows), desc=name, unit="push", disable=None) as bar:
        for first in range(0, len(rows), BATCH):
            yield rows[first : first + BATCH]
            bar.update(len(rows[first : first + BATCH]))


def doubts(table: PushTable) -> list[str]:
    """Return a sentence if outlines and pushes do not seem to fit: objects that moved, although no tip met them."""
    missed = np.zeros(table.count, dtype=np.bool_)
    for number, item in enumerate(table.objects):
        rows = np.flatnonzero(table.object_index == number)
        travel_m = first_contact(item.outline, table.pushers[rows], table.pusher_radius_m[rows]).travel_m
        missed[rows] = np.isinf(travel_m)
    moved = missed & (np.hypot(table.outcomes[:, 0], table.outcomes[:, 1]) > MOVED_M)
    if moved.mean() <= DOUBTFUL:
        return []
    return [
        f"{int(moved.sum()):,} of {table.count:,} pushes never meet the outline, and the object moved all the same: do "
        "units, frame, outline and tip fit? `cazsl-train data check FOLDER` tells."
    ]


def choose(table: PushTable, shapes: Sequence[str], limit: int | None) -> PushTable:
    """Return the pushes of some objects, and at most so many of them, drawn with a fixed seed.

    Raises:
        DataError: the table has no such object.
    """
    if shapes:
        names = [item.name for item in table.objects]
        unknown = [name for name in shapes if name not in names]
        if unknown:
            raise DataError(f"--shapes: the table has no object {unknown[0]!r}; it has {', '.join(names[:20])}")
        table = table.select(np.isin(table.object_index, [names.index(name) for name in shapes]))
    if limit is not None and limit < table.count:
        table = table.select(np.sort(np.random.default_rng(0).choice(table.count, limit, replace=False)))
    return table
