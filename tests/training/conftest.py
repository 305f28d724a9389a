"""Fixtures of the trainer's tests, small data and finished runs, and the rule that skips them without the extra.

This file is loaded even without torch, so modules that need torch are imported inside the fixtures.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from service.pushing.contexts import ObjectContext
from training.omnipush.declaration import declare_dataset
from training.omnipush.published import omnipush_descriptors
from training.omnipush.pushes import Pushes, read_folder, write_object

if TYPE_CHECKING:
    from training.fitting.recipe import Recipe


def pytest_pycollect_makemodule(module_path: Path) -> None:
    """Skip this folder without the trainer's extra, as a service needs neither torch nor MuJoCo."""
    for package in ("torch", "mujoco", "onnxscript"):
        pytest.importorskip(package, reason=f"{module_path.parent.name} needs the extra 'training': no {package}")


@pytest.fixture(scope="session", autouse=True)
def one_thread() -> Iterator[None]:
    """Keep torch on one thread, as small batches are no faster on more, and threads on busy cores wait."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="session")
def recipe() -> "Recipe":
    """Recipe of the paper's masked and regularised network for a few epochs."""
    from training.fitting.recipe import Recipe

    return Recipe(
        name="push-indicator",
        method="FCN + CM + L2Reg",
        context="indicator",
        set_up="different-objects",
        epochs=3,
        batch_objects=64,
        learning_rate=0.002,
        warm_up_steps=0,
        lambda_1=0.01,
        lambda_2=10.0,
        precision="float32",
        seed=0,
    )


@pytest.fixture(scope="session")
def data_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with one to three simple pushes of each of the 250 objects: objects with more weights turn more."""
    folder, rng = tmp_path_factory.mktemp("data"), np.random.default_rng(20)
    declare_dataset(folder, {"source": "synthetic pushes of a test"})
    for number, descriptor in enumerate(omnipush_descriptors()):
        bearing = rng.uniform(-math.pi, math.pi, 1 + number % 3)
        angle = np.angle(np.exp(1j * (bearing + math.pi)))
        pushers = np.column_stack([0.08 * np.cos(bearing), 0.08 * np.sin(bearing), angle])
        weights = sum(side.weight != "a" for side in ObjectContext.from_descriptor(descriptor).sides)
        turn = np.full(len(bearing), 0.1 * weights)
        write_object(folder, descriptor, pushers, np.column_stack([0.02 * np.cos(angle), 0.02 * np.sin(angle), turn]))
    return folder


@pytest.fixture(scope="session")
def indicator_run(tmp_path_factory: pytest.TempPathFactory, data_folder: Path, recipe: "Recipe") -> Path:
    """Finished run of the paper's network on the synthetic pushes. Tests must not change it."""
    from training.fitting.samples import read_training_data
    from training.fitting.training_loop import fit

    folder = tmp_path_factory.mktemp("indicator")
    fit(recipe, read_training_data(recipe.split(), recipe.context_kind, data_folder), folder, quiet=True)
    return folder


@pytest.fixture(scope="session")
def none_run(tmp_path_factory: pytest.TempPathFactory, data_folder: Path, recipe: "Recipe") -> Path:
    """Finished run of the baseline without context on the synthetic pushes. Tests must not change it."""
    from training.fitting.samples import read_training_data
    from training.fitting.training_loop import fit

    folder = tmp_path_factory.mktemp("none")
    baseline = replace(recipe, name="push-none", method="FCN", context="none")
    fit(baseline, read_training_data(baseline.split(), baseline.context_kind, data_folder), folder, quiet=True)
    return folder


@pytest.fixture(scope="session")
def support_run(tmp_path_factory: pytest.TempPathFactory, data_folder: Path, recipe: "Recipe") -> Path:
    """Finished run of a neural process for serving on the synthetic pushes. Tests must not change it."""
    from training.fitting.samples import read_training_data
    from training.fitting.training_loop import fit

    folder = tmp_path_factory.mktemp("support")
    process = replace(recipe, name="push-anp", method="ANP", context="support", angle="push-frame", least_std=0.01)
    fit(process, read_training_data(process.split(), process.context_kind, data_folder), folder, quiet=True)
    return folder


@pytest.fixture(scope="session")
def viewed_pushes(data_folder: Path) -> Pushes:
    """Synthetic pushes with made-up views: noise of its own for each object."""
    pushes = read_folder(data_folder)
    shape = (len(pushes.descriptors), 1, 32, 32)
    return pushes.with_views(np.random.default_rng(5).integers(256, size=shape, dtype=np.uint8))


@pytest.fixture(scope="session")
def visual_run(tmp_path_factory: pytest.TempPathFactory, viewed_pushes: Pushes, recipe: "Recipe") -> Path:
    """Finished run with visual contexts on the synthetic pushes. Tests must not change it."""
    from training.fitting.samples import TrainingData
    from training.fitting.training_loop import fit

    folder = tmp_path_factory.mktemp("visual")
    visual = replace(recipe, name="push-visual", method="FCN + CM + NeuralReg", context="visual", lambda_2=1.0)
    fit(visual, TrainingData.of(visual.split(), visual.context_kind, viewed_pushes), folder, quiet=True)
    return folder


@pytest.fixture(scope="session")
def shapes_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a small table of drawn shapes of eight families. Tests must not change it."""
    from service.bulk.executors import SerialExecutor
    from training.shapes.dataset import ShapePlan, simulate_shapes

    families = ("box", "L", "star", "mug", "irregular-polygon", "T", "wrench", "bean")
    folder = tmp_path_factory.mktemp("shapes")
    simulate_shapes(ShapePlan(objects=40, pushes=20, families=families), folder, SerialExecutor(), quiet=True)
    return folder


@pytest.fixture(scope="session")
def shape_recipe(recipe: "Recipe") -> "Recipe":
    """Recipe of a masked network of shapes for two epochs."""
    shaped = replace(recipe, name="push-shape", method="FCN + CM", context="shape", set_up="different-families")
    return replace(shaped, epochs=2, lambda_1=0.0, lambda_2=0.0)


@pytest.fixture(scope="session")
def shape_run(tmp_path_factory: pytest.TempPathFactory, shapes_folder: Path, shape_recipe: "Recipe") -> Path:
    """Finished run of the network of shapes. Tests must not change it."""
    from training.fitting.shape_samples import read_shapes, shape_training_data
    from training.fitting.training_loop import fit

    folder = tmp_path_factory.mktemp("shape")
    table, split = read_shapes(shapes_folder, shape_recipe.set_up)
    fit(shape_recipe, shape_training_data(table, split, shape_recipe.seed, quiet=True), folder, quiet=True)
    return folder
