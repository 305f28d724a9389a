"""Options of a reproduction of the paper's tables, and the command that repeats it."""

from dataclasses import dataclass, replace
from pathlib import Path

from training.omnipush.layout import data_options
from training.paper.experiments import EXPERIMENTS, GAUSSIAN_PROCESS, Experiment, experiments


@dataclass(frozen=True, kw_only=True)
class ReproductionOptions:
    """Options of a reproduction.

    Raises:
        ValueError: The options contradict each other. The message names them.
    """

    names: tuple[str, ...] = ()
    everything: bool = False
    epochs: int | None = None  # per run; None: as many as the paper
    seeds: int | None = None  # per row; None: the experiment's default
    cooling: int = 0  # last epochs over which the learning rate falls to zero
    skip: tuple[str, ...] = ()  # methods without a row
    out: Path  # holds a folder per experiment
    jobs: int | None = None  # runs at once on this machine; None: one per processor
    ray_address: str | None = None
    known: Path | None = None  # figures.json of an earlier reproduction
    data: Path
    views: Path | None = None

    def __post_init__(self) -> None:
        if self.everything == bool(self.names):
            raise ValueError(f"give one or more of {', '.join(EXPERIMENTS)}, or --all")
        if self.jobs is not None and self.ray_address is not None:
            raise ValueError("--jobs counts runs on this machine; give either that or --ray")
        if self.known is not None and len(self.names) != 1:
            raise ValueError("--known holds the runs of one experiment; give its name alone")
        for experiment in self.experiments():
            epochs = self.epochs_of(experiment)
            if self.cooling > epochs:
                raise ValueError(
                    f"--cooling: received {self.cooling}; give at most {epochs}, the epochs of {experiment.name}"
                )

    def experiments(self) -> list[Experiment]:
        """Return the experiments named, in order, without the rows to skip and with the cooling."""
        known = experiments()
        names = EXPERIMENTS if self.everything else self.names
        return [replace(known[name].without(self.skip), cooling_epochs=self.cooling) for name in names]

    def epochs_of(self, experiment: Experiment) -> int:
        """Return the epochs of each run of an experiment."""
        return self.epochs or experiment.epochs

    def seeds_of(self, experiment: Experiment) -> int:
        """Return the number of runs of each row of an experiment."""
        return self.seeds or experiment.seeds

    def command(self, experiment: Experiment) -> str:
        """Render the command that repeats one experiment. Its report shows this text."""
        words = [
            f"cazsl-train reproduce {experiment.name}",
            f"--epochs {self.epochs_of(experiment)} --seeds {self.seeds_of(experiment)} --out {self.out}",
            *([f"--cooling {self.cooling}"] if self.cooling else []),
            *(f"--skip '{method}'" for method in self.skip),
            *([] if self.known is None else [f"--known {self.known}"]),
        ]
        data = "" if experiment.name == GAUSSIAN_PROCESS else data_options(self.data, self.views)
        return " ".join(words) + data
