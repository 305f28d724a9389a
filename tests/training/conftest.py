"""What the trainer's tests share: the rule that skips them without the trainer's extra, and small data and runs.

This file is loaded even where torch is absent, so whatever needs it is imported inside the fixtures.
"""

from pathlib import Path

import pytest


def pytest_pycollect_makemodule(module_path: Path) -> None:
    """Skip this folder where the trainer's extra is not installed: a service needs neither torch nor MuJoCo."""
    for package in ("torch", "mujoco", "onnxscript"):
        pytest.importorskip(package, reason=f"{module_path.parent.name} needs the extra 'training': no {package}")


@pytest.fixture(scope="session")
def data_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Synthetic pushes of all 250 objects, one to three of each, in Omnipush's file format."""
    from tests.training import synthetic

    return synthetic.write_data(tmp_path_factory.mktemp("data"))


@pytest.fixture(scope="session")
def indicator_run(tmp_path_factory: pytest.TempPathFactory, data_folder: Path) -> Path:
    """A finished run of the paper's masked and regularised network on the synthetic pushes."""
    from tests.training import synthetic

    return synthetic.finish_run(tmp_path_factory.mktemp("indicator"), data_folder, "FCN + CM + L2Reg")


@pytest.fixture(scope="session")
def none_run(tmp_path_factory: pytest.TempPathFactory, data_folder: Path) -> Path:
    """A finished run of the baseline without context on the synthetic pushes."""
    from tests.training import synthetic

    return synthetic.finish_run(tmp_path_factory.mktemp("none"), data_folder, "FCN")
