"""Learn a policy for one task over a family of materials, in a folder from which the same training goes on.

    policy.json      what is learnt, and how (:class:`Training`)
    progress.json    the last checkpoint, and what it took up to there
    encoder.npz      what the policy sees of observations (:mod:`sim_core.policies.encoder`)
    checkpoint_N/    model.zip and, for SAC, replay.pkl
    episodes.jsonl   each episode: its materials, return, reward, whether it was a success, why it ended early

PPO (Schulman et al. 2017) and SAC (Haarnoja et al. 2018) are those of Stable-Baselines3. Training is made of rounds. In
the first one decisions are drawn about zero; the encoder is fitted to what is observed, and SAC learns from it later. A
policy begins with decisions about zero too: it makes the motion about which it decides. Each round begins with new
episodes and with all random numbers drawn anew from the seed and its number. So a training that goes on from a
checkpoint, which is made after each round, gives to the bit what it gives without an interruption.
"""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from pickle import UnpicklingError
from typing import Any
from zipfile import BadZipFile

import numpy as np
import torch
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.utils import set_random_seed

from sim_core.errors import ConfigError, nearest_match
from sim_core.policies.batch import Batch
from sim_core.policies.encoder import Encoder, fitted, read_encoder
from sim_core.tasks.environment import TaskEnv
from sim_core.tasks.observation import Kind

POLICY, PROGRESS, EPISODES, CHECKPOINT = "policy.json", "progress.json", "episodes.jsonl", "checkpoint_{}"
ENCODER = "encoder.npz"

FORMAT = 2

NETWORK = [64, 64]
"""Sizes of the hidden layers of all networks."""

ALGORITHMS: dict[str, tuple[type[BaseAlgorithm], dict[str, Any]]] = {
    "ppo": (PPO, {"learning_rate": 1e-3}),
    "sac": (
        SAC,
        {"learning_starts": 0, "batch_size": 128, "tau": 0.01, "ent_coef": "auto_0.003"},
    ),
}
"""What is not the library's default."""

SPREAD = -1.6
"""Logarithm of the standard deviation of the first decisions: a fifth of what may be decided, since noise in all
components of all decisions adds up."""

UPDATES = 1
"""Steps of SAC's optimiser for each decision. With 8, its critic fits the few decisions that there are so closely that,
after 800 steps, the policy leaves what had gained most for what was never tried."""


@dataclass(frozen=True)
class Training:
    """What is learnt. ``vary``: intervals of parameters of the rig by name; ``around``: an action of the task about
    which is decided, ``reach`` as far (:class:`sim_core.tasks.environment.TaskEnv`); ``envs``: episodes side by side,
    ``rounds`` of ``episodes`` each, as many for every environment."""

    task: str
    algorithm: str = "sac"
    vary: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    observe: Kind = "sensors"
    around: tuple[float, ...] | None = None
    reach: float = 1.0
    seed: int = 0
    envs: int = 8
    episodes: int = 3

    def options(self) -> dict[str, Any]:
        """Of the environments."""
        around = None if self.around is None else np.array(self.around)
        return {"vary": dict(self.vary), "observe": self.observe, "around": around, "reach": self.reach}


@dataclass(frozen=True)
class Progress:
    """``rounds`` that were made, with so many ``decisions`` and ``steps`` of simulation, in ``wall_s`` and ``cpu_s`` of
    the process [s]; ``lines`` of the log of episodes."""

    rounds: int = 0
    decisions: int = 0
    steps: int = 0
    wall_s: float = 0.0
    cpu_s: float = 0.0
    lines: int = 0


OnRound = Callable[[float, str], None]


def train(
    training: Training,
    rounds: int,
    folder: Path,
    workers: int = 1,
    on_round: OnRound | None = None,
    seconds: float = float("inf"),
) -> Progress:
    """Learn for so many rounds in all, with those that the folder has already. No round begins after ``seconds`` of
    wall time.

    Raises ``ConfigError`` where the folder has another training, and for an algorithm that there is not.
    """
    if training.algorithm not in ALGORITHMS:
        raise ConfigError(
            f"There is no algorithm {training.algorithm!r}.", nearest_match(training.algorithm, ALGORITHMS)
        )
    progress, began = _opened(training, folder), time.monotonic()
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # sums of other numbers of threads differ in their last digits
    batch = Batch(training.task, training.envs, workers, **training.options())
    try:
        if not progress.rounds:
            progress = _first_round(training, folder, batch)
        batch.see_by(read_encoder(folder / ENCODER))
        model = _read_model(training, progress, folder, batch)
        for number in range(progress.rounds, rounds):
            if time.monotonic() - began > seconds:
                break
            log = _Log(folder / EPISODES)
            progress = _round(training, model, batch, number, progress, log)
            _keep(model, folder, progress)
            if on_round is not None:
                on_round(
                    (number + 1) / rounds, f"{log.count} episodes, return {log.mean:.3g}, {log.successes} successes"
                )
    finally:
        batch.close()
        torch.set_num_threads(threads)
    return progress


def _seed(training: Training, number: int) -> int:
    """Of the round with this number."""
    return int(np.random.SeedSequence([training.seed, number]).generate_state(1)[0] >> 1)


def _first_round(training: Training, folder: Path, batch: Batch) -> Progress:
    """Decisions that are drawn: fit the encoder, begin the policy, and let SAC remember them."""
    began, log, seed = _Began(), _Log(folder / EPISODES), _seed(training, 0)
    rng = np.random.default_rng(seed)
    set_random_seed(seed)
    batch.seed(seed)
    before = batch.reset()
    running, whole, steps = [[seen] for seen in before], [], []
    for _ in range(_knots(batch) * training.episodes):
        drawn = np.exp(SPREAD) * rng.standard_normal((training.envs, *batch.action_space.shape))
        decisions = np.clip(drawn, -1.0, 1.0).astype(np.float32)
        begun, gained, over, infos = batch.step(decisions)
        after = begun.copy()
        for k in range(training.envs):
            after[k] = infos[k].get("terminal_observation", begun[k])
            running[k].append(after[k])
            if over[k]:
                whole += [running[k]] if len(running[k]) == _knots(batch) + 1 else []
                running[k] = [begun[k]]
        steps.append((before, after, decisions, gained, over, infos))
        log.note(gained, over, infos)
        before = begun
    if len(whole) < 2:
        raise ConfigError(
            f"{len(whole)} of the {log.count} episodes with drawn decisions came to their last decision.",
            "Choose a smaller reach, or another motion to decide about.",
        )
    encoder = fitted(np.array(whole), batch.tasks.envs[0].noise)
    encoder.write(folder / ENCODER)
    batch.see_by(encoder)
    model = _new_model(training, batch)
    if isinstance(model, SAC):
        for before, after, *rest in steps:
            model.replay_buffer.add(encoder.encode(before), encoder.encode(after), *rest)
    progress = _further(training, Progress(), batch, began, log)
    _keep(model, folder, progress)
    return progress


def _round(
    training: Training, model: BaseAlgorithm, batch: Batch, number: int, before: Progress, log: _Log
) -> Progress:
    """One round: new episodes, and all that is drawn from the seed and the number of the round."""
    began, seed = _Began(), _seed(training, number)
    set_random_seed(seed)
    model.action_space.seed(seed)
    batch.seed(seed)
    model.set_env(batch, force_reset=True)
    model.learn(_knots(batch) * training.envs * training.episodes, callback=log, reset_num_timesteps=False)
    return _further(training, before, batch, began, log)


class _Began:
    """When something began: wall time and process time [s]."""

    def __init__(self) -> None:
        self.wall, self.cpu = time.monotonic(), time.process_time()


def _further(training: Training, before: Progress, batch: Batch, began: _Began, log: _Log) -> Progress:
    """After another round."""
    decisions = _knots(batch) * training.envs * training.episodes
    steps = len(batch.tasks.envs[0].rollouts.times) - 1
    return Progress(
        before.rounds + 1,
        before.decisions + decisions,
        before.steps + steps * training.envs * training.episodes,
        before.wall_s + time.monotonic() - began.wall,
        before.cpu_s + time.process_time() - began.cpu,
        before.lines + log.count,
    )


def _knots(batch: Batch) -> int:
    """Decisions of an episode."""
    return int(batch.tasks.envs[0].made.actions.knots)


class _Log(BaseCallback):
    """Writes down episodes that are over."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._path, self.count, self.successes, self._returns = path, 0, 0, 0.0
        self._sums: np.ndarray | None = None

    @property
    def mean(self) -> float:
        """Return of an episode."""
        return self._returns / max(1, self.count)

    def _on_step(self) -> bool:
        self.note(*(self.locals[name] for name in ("rewards", "dones", "infos")))
        return True

    def note(self, gained: np.ndarray, over: np.ndarray, infos: Sequence[Mapping[str, Any]]) -> None:
        """Of a decision in each environment, what it gained and which episodes are over."""
        self._sums = gained.astype(float) if self._sums is None else self._sums + gained
        with self._path.open("a", encoding="utf-8") as stored:
            for k in np.flatnonzero(over).tolist():
                end = {name: infos[k][name] for name in ("reward", "success", "stopped", "parameters")}
                stored.write(json.dumps({"return": float(self._sums[k]), **end}) + "\n")
                self.count += 1
                self.successes += infos[k]["success"]
                self._returns += float(self._sums[k])
                self._sums[k] = 0.0


def _read_model(training: Training, progress: Progress, folder: Path, batch: Batch) -> BaseAlgorithm:
    """The policy of the last checkpoint."""
    place = folder / CHECKPOINT.format(progress.rounds)
    with _reading(place):
        model = ALGORITHMS[training.algorithm][0].load(place / "model.zip", env=batch, device="cpu")
        if isinstance(model, SAC):
            model.load_replay_buffer(place / "replay.pkl")
    return model


def _new_model(training: Training, batch: Batch) -> BaseAlgorithm:
    """A policy that decides about zero."""
    kind, options = ALGORITHMS[training.algorithm]
    policy: dict[str, Any] = {"net_arch": NETWORK}
    knots = _knots(batch)
    if training.algorithm == "ppo":
        policy["log_std_init"] = SPREAD
        options = {**options, "n_steps": knots, "batch_size": knots * training.envs}
    else:
        options = {**options, "train_freq": 1, "gradient_steps": UPDATES * training.envs, "buffer_size": 100_000}
    shared = {"gamma": 1.0, "policy_kwargs": policy, "device": "cpu", "seed": training.seed}
    model = kind("MlpPolicy", batch, **options, **shared)
    if isinstance(model, SAC):
        for layer, start in ((model.actor.mu, 0.0), (model.actor.log_std, SPREAD)):
            torch.nn.init.zeros_(layer.weight)
            torch.nn.init.constant_(layer.bias, start)
    return model


def _keep(model: BaseAlgorithm, folder: Path, progress: Progress) -> None:
    """Write a checkpoint, and then that it is the last one."""
    place = folder / CHECKPOINT.format(progress.rounds)
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir()
    model.save(place / "model.zip")
    if isinstance(model, SAC):
        model.save_replay_buffer(place / "replay.pkl")
    _write_progress(folder, progress)
    for old in folder.glob(CHECKPOINT.format("*")):
        if old != place:
            shutil.rmtree(old)


def _write_progress(folder: Path, progress: Progress) -> None:
    new = folder / f"{PROGRESS}.new"
    new.write_text(json.dumps(asdict(progress), indent=1) + "\n", encoding="utf-8")
    os.replace(new, folder / PROGRESS)


def _opened(training: Training, folder: Path) -> Progress:
    """What the folder has of this training, with the log as long as it was at the checkpoint; a new one is made."""
    about = json.loads(json.dumps({"format": FORMAT, **asdict(training)}))
    try:
        if (folder / POLICY).exists():
            if json.loads((folder / POLICY).read_text(encoding="utf-8")) != about:
                raise ConfigError(
                    f"The folder {folder} has another training.", "Name a new folder, or ask for the same training."
                )
        elif folder.exists() and any(folder.iterdir()):
            raise ConfigError(f"The folder {folder} has other files in it.", "Name a new folder.")
        else:
            TaskEnv(training.task, **training.options())  # a training that cannot begin leaves no folder
            folder.mkdir(parents=True, exist_ok=True)
            (folder / POLICY).write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
        progress = read_progress(folder)
        log = folder / EPISODES
        if log.exists():
            lines = log.read_text(encoding="utf-8").splitlines(keepends=True)[: progress.lines]
            log.write_text("".join(lines), encoding="utf-8")
    except (OSError, ValueError) as error:
        raise ConfigError(f"The folder {folder} cannot be used: {error}.", "Name another one.") from None
    return progress


def read_progress(folder: Path) -> Progress:
    """How far a training is. Raises ``ConfigError`` where that cannot be read."""
    path = folder / PROGRESS
    try:
        return Progress(**json.loads(path.read_text(encoding="utf-8"))) if path.exists() else Progress()
    except (OSError, ValueError, TypeError) as error:
        raise ConfigError(f"{path} is not of a training: {error}.", "Name a new folder, and train anew.") from None


@contextmanager
def _reading(place: Path) -> Iterator[None]:
    """Errors of a checkpoint that is missing or damaged as ``ConfigError``."""
    try:
        yield
    except (OSError, EOFError, ValueError, KeyError, AttributeError, BadZipFile, UnpicklingError) as error:
        raise ConfigError(f"The checkpoint {place} cannot be read: {error}.", "Train anew in a new folder.") from None


def read_training(folder: Path) -> Training:
    """What is learnt in a folder. Raises ``ConfigError`` for one that has no training."""
    try:
        data = json.loads((folder / POLICY).read_text(encoding="utf-8"))
        if data.pop("format") != FORMAT:
            raise ValueError(f"its format is not {FORMAT}")
        vary = {name: (float(low), float(high)) for name, (low, high) in data.pop("vary").items()}
        around = data.pop("around")
        return Training(**data, vary=vary, around=None if around is None else tuple(around))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"{folder} has no policy: {error}.", "Name a folder of 'thinshell policy train'.") from None


@dataclass(frozen=True)
class Policy:
    """A policy that was learnt. Its pickled files run code when they are read: load only those of whom you trust."""

    training: Training
    model: BaseAlgorithm
    encoder: Encoder

    def decision(self, observation: np.ndarray) -> np.ndarray:
        """What it decides for an observation ``(m,)``: ``(k,)``, without exploration."""
        decided, _ = self.model.predict(self.encoder.encode(observation[None]), deterministic=True)
        return np.asarray(decided[0])


def load_policy(folder: Path) -> Policy:
    """The policy of the last checkpoint. Raises ``ConfigError`` where there is none."""
    training, progress = read_training(folder), read_progress(folder)
    place = folder / CHECKPOINT.format(progress.rounds)
    if not progress.rounds or not place.is_dir():
        raise ConfigError(f"{folder} has no checkpoint yet.", "Let 'thinshell policy train' make a round.")
    with _reading(place):
        model = ALGORITHMS[training.algorithm][0].load(place / "model.zip", device="cpu")
    return Policy(training, model, read_encoder(folder / ENCODER))
