"""Results made of synthetic data for the tests of the reports."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sysid.diagnosis.result import (
    Candidate,
    Diagnosis,
    Located,
    LocatedChannel,
    Misfit,
    NamedParameter,
    UnreliablePlace,
)
from sysid.diagnosis.verdict import ProbableSet, Verdict
from sysid.fit.result import ChannelError, Estimate, FitResult, Series

NOISE = {("wrench_gel", "force"): 2e-3, ("wrench_gel", "torque"): 1e-5, ("gel_markers", ""): 1e-5, ("outside", ""): 0.1}
UNIT = {("wrench_gel", "force"): "N", ("wrench_gel", "torque"): "N m", ("gel_markers", ""): "m", ("outside", ""): "px"}
COLUMNS = {
    ("wrench_gel", "force"): ("force z",),
    ("wrench_gel", "torque"): ("torque y",),
    ("gel_markers", ""): ("marker 12 z",),
    ("outside", ""): ("marker 26 v",),
}
SIZE = {("wrench_gel", "force"): 0.6, ("wrench_gel", "torque"): 4e-3, ("gel_markers", ""): 6e-4, ("outside", ""): 45.0}
PROVENANCE = {
    "rig": "name: card_press\ngravity_m_s2: [0.0, 0.0, -9.81]\nbodies:\n  card: {type: sheet}\n",
    "bags": [
        {"path": "bags/press_1", "sha256": ["3f" * 32], "held_out": False, "notes": ["wrench_gel: 3 samples lost"]},
        {"path": "bags/press_2", "sha256": ["a7" * 32], "held_out": False, "notes": []},
        {"path": "bags/slide_1", "sha256": ["0c" * 32], "held_out": True, "notes": []},
    ],
    "versions": {"python": "3.11.7", "thinshell_ros": "0.1.0", "numpy": "2.2.0", "scipy": "1.15.0"},
    "machine": "Linux x86_64",
    "seed": 0,
    "command": "thinshell fit card_press bags/press_1 bags/press_2 --held-out bags/slide_1 --out fit",
}


def press(t: np.ndarray) -> np.ndarray:
    """A press, a hold and a release."""
    return np.clip((t - 0.5) / 0.8, 0, 1) - np.clip((t - 3.2) / 0.6, 0, 1)


def make_series(
    runs: tuple[tuple[str, bool], ...], *, before: float = 0.35, after: float = 0.0, n: int = 400
) -> list[Series]:
    """Series of every channel; ``before``, ``after``: relative error of either model during the hold."""
    rng = np.random.default_rng(3)
    out = []
    for run, held_out in runs:
        t = np.linspace(0.0, 4.5, n)
        shape = press(t)
        fading = shape * (1.0 - np.exp(-np.clip(t - 1.3, 0, None) / 0.5))
        for (channel, quantity), labels in COLUMNS.items():
            key = (channel, quantity)
            for k, label in enumerate(labels):
                size = SIZE[key] * (1.0 if k == 0 else 0.3)
                truth = size * (shape - 0.3 * fading)
                offset = 0.0501 if channel == "gel_markers" else 360.0 if channel == "outside" else 0.0
                noisy = truth + offset + NOISE[key] * rng.standard_normal(n)
                measured = [float(v) for v in noisy]
                if channel == "gel_markers":
                    measured[n // 10 : n // 8] = [None] * (n // 8 - n // 10)  # type: ignore[list-item]
                out.append(
                    Series(
                        run, channel, label, UNIT[key], held_out, t.tolist(), measured,
                        (truth + offset + before * size * fading).tolist(),
                        (truth + offset + after * size * fading).tolist(),
                    )
                )  # fmt: skip
    return out


def make_errors(
    runs: tuple[tuple[str, bool], ...], *, before: float, after: float, start: float | None = None
) -> list[ChannelError]:
    """Errors as multiples of the noise."""
    return [
        ChannelError(run, c, q, UNIT[c, q], before * s, (after + 0.01 * k) * s, s, held_out, 0.925 * s, 0.2 * s)
        for run, held_out in runs
        for k, ((c, q), s) in enumerate(NOISE.items())
    ]


RUNS = (("press_1", False), ("press_2", False), ("slide_1", True))


def make_fit(**changes: object) -> FitResult:
    """A good fit with one pair of parameters traded off and one at its bound."""
    values: dict[str, object] = {
        "rig": "card_press",
        "estimates": [
            Estimate("card.E_pa", "Pa", 3.0e9, 2.0312e9, (1.981e9, 2.083e9), 0.0128, True, False),
            Estimate("gel.E_pa", "Pa", 2.0e5, 1.2345e5, (1.19e5, 1.281e5), 0.019, True, False),
            Estimate("gel.nu", "-", 0.45, 0.4949, (0.31, 0.495), 0.09, False, True),
            Estimate("contacts.gel-card.friction", "-", 0.4, 0.5123, (0.5011, 0.5235), 0.0057, False, False),
        ],
        "correlation": [
            [1.0, -0.21, 0.08, 0.02],
            [-0.21, 1.0, -0.985, 0.31],
            [0.08, -0.985, 1.0, -0.44],
            [0.02, 0.31, -0.44, 1.0],
        ],
        "identifiability": [
            "The data do not determine gel.nu: 1 to 2 fit about as well. Record a motion "
            "that depends on it, or fix it.",
            "gel.E_pa and gel.nu are traded off against each other (correlation -0.985): if one is really higher, "
            "the other goes down.",
        ],
        "undetermined": {"gel.nu"},
        "errors": make_errors(RUNS, before=17.3, after=1.02),
        "misfit": 1.07,
        "reduced_chi2": 1.08,
        "converged": True,
        "message": "`ftol` termination condition is satisfied.",
        "evaluations": 9,
        "seconds": 214.0,
        "noise": {
            "wrench_gel": {"sigma": 1e-3, "correlation": 0.0, "from": "quiet stretches"},
            "gel_markers": {"sigma": 1e-5, "correlation": 0.42, "from": "quiet stretches"},
            "outside": {"sigma": 0.1, "correlation": 0.0, "from": "third differences"},
        },
        "notes": ["press_1: wrench_gel: 3 samples lost", "slide_1: stamps of outside jump by 0.2 s at 1.4 s"],
        "provenance": PROVENANCE,
        "series": make_series(RUNS),
    }
    return FitResult(**{**values, **changes})  # type: ignore[arg-type]


def gel_relaxation(probability: float) -> Candidate:
    """An effect as the answer."""
    return Candidate(
        "gel_relaxation", "the gel relaxes", "gel",
        "The gel's stress fades while it is held deformed: a share g of its shear stress decays with the time "
        "constant tau (a Maxwell element parallel to the spring).",
        probability,
        (
            NamedParameter(
                "effects.gel_relaxation.share", 0.2987, (0.2911, 0.3063), "-", "share of the shear stress that fades"
            ),
            NamedParameter("effects.gel_relaxation.tau_s", 0.4921, (0.4605, 0.5259), "s", "time constant"),
        ),
        812.4, 0.974, 0.968,
    )  # fmt: skip


def plasticity(probability: float) -> Candidate:
    """A rival."""
    return Candidate(
        "bending_plasticity", "the sheet keeps a bend", "sheet",
        "The sheet does not spring back fully: where it was bent beyond the yield curvature it keeps a permanent "
        "curvature, whatever the speed.",
        probability,
        (
            NamedParameter(
                "effects.bending_plasticity.yield_curvature_per_m", 8.31, (6.9, 10.2), "1/m",
                "curvature at which flow begins",
            ),
            NamedParameter(
                "effects.bending_plasticity.hardening_ratio", 0.2, (0.05, 0.6), "-", "hardening over bending stiffness"
            ),
        ),
        214.0, 0.31, 0.34,
    )  # fmt: skip


def compliance(probability: float, held_out_gain: float | None = 0.05) -> Candidate:
    """Another rival."""
    return Candidate(
        "end_effector_compliance", "the end effector gives way", "robot",
        "The hand is not where the robot says: mount, wrist or gripper yield in proportion to the force.",
        probability,
        (
            NamedParameter(
                "effects.end_effector_compliance.compliance_m_per_n", 2.31e-4, (1.1e-4, 4.8e-4), "m/N",
                "displacement per force",
            ),
        ),
        38.5, held_out_gain,
    )  # fmt: skip


def make_diagnosis(verdict: str, **changes: object) -> Diagnosis:
    """A diagnosis of each kind."""
    baseline = (
        NamedParameter("card.E_pa", 2.31e9, (2.27e9, 2.35e9), "Pa", "Young's modulus of card"),
        NamedParameter("gel.E_pa", 0.98e5, (0.96e5, 1.0e5), "Pa", "Young's modulus of gel"),
        NamedParameter("contacts.gel-card.friction", 0.47, (0.43, 0.51), "-", "friction coefficient"),
    )
    amended = (
        NamedParameter("card.E_pa", 2.03e9, (1.99e9, 2.07e9), "Pa", "Young's modulus of card"),
        NamedParameter("gel.E_pa", 1.24e5, (1.21e5, 1.27e5), "Pa", "Young's modulus of gel"),
        NamedParameter("contacts.gel-card.friction", 0.49, (0.46, 0.52), "-", "friction coefficient"),
    )
    located = Located(
        (
            LocatedChannel("wrench_gel", "force", 0.71),
            LocatedChannel("gel_markers", "position", 0.22),
            LocatedChannel("wrench_gel", "torque", 0.05),
            LocatedChannel("outside", "position", 0.02),
        ),
        {"press_1": ((1.3, 3.3),), "press_2": ((1.3, 2.1), (2.4, 3.3)), "slide_1": ((1.4, 3.2),)},
        "holding in contact",
    )
    values: dict[str, object] = {
        "verdict": verdict,
        "sentence": "The gel relaxes: 30 % of its shear stress fades with a time constant of 0.49 s.",
        "rig": "card_press",
        "effects": (gel_relaxation(0.993),),
        "alternatives": (plasticity(0.0061), compliance(0.0009)),
        "located": located,
        "baseline": Misfit(48.2, 51.7, tuple(make_errors(RUNS, before=9.0, after=7.1))),
        "amended": Misfit(1.06, 1.11, tuple(make_errors(RUNS, before=7.1, after=1.03))),
        "noise_floor": {"wrench_gel": 2e-3, "gel_markers": 1e-5, "outside": 0.1},
        "upper_limits": {
            "effects.gel_relaxation.share": 0.3051,
            "effects.end_effector_compliance.compliance_m_per_n": 3.1e-5,
        },
        "baseline_parameters": baseline,
        "amended_parameters": amended,
        "not_explained": "",
        "next_experiment": "Press and hold at three depths for 5 s each: it would narrow the time constant by half.",
        "provenance": {
            **{k: v for k, v in PROVENANCE.items() if k != "seed"},
            "command": "thinshell diagnose card_press bags/press_1 --out diagnosis",
        },
        "seconds": 1812.0,
        "series": make_series(RUNS),
        "explained": 0.968,
        "posterior": Verdict(
            "named",
            (ProbableSet(("gel_relaxation",), "the gel relaxes", 0.93),),
            0.003,
            0.04,
            {"gel_relaxation": 0.95},
            {"gel": 0.99},
        ),
    }
    if verdict == "one_of":
        values |= {
            "sentence": "Either the gel relaxes or the sheet keeps a bend: these recordings do not tell them apart.",
            "effects": (gel_relaxation(0.58), plasticity(0.41)),
            "alternatives": (compliance(0.01),),
            "next_experiment": "Press and hold for 5 s, release, and wait for 5 s: after the release the gel's force "
            "returns to zero with time, a bend of the sheet stays.",
        }
    if verdict == "nothing_missing":
        values |= {
            "sentence": "Nothing is missing: the rig explains the recordings down to their noise and the simulator's "
            "discretisation error.",
            "effects": (),
            "alternatives": (
                gel_relaxation(0.04),
                compliance(0.02, None),
            ),
            "located": Located((), {"press_1": (), "press_2": (), "slide_1": ()}, "nowhere in particular"),
            "baseline": Misfit(1.04, 1.07, tuple(make_errors(RUNS, before=9.0, after=1.01))),
            "amended": None,
            "upper_limits": {
                "effects.gel_relaxation.share": 0.021,
                "effects.end_effector_compliance.compliance_m_per_n": 3.1e-5,
            },
            "amended_parameters": (),
            "next_experiment": "",
            "series": make_series(RUNS, before=0.0),
        }
    if verdict == "refine_discretisation":
        quiet = make_diagnosis("nothing_missing", **changes)
        said = (
            "Nothing can be said to be missing or not: the misfit is no larger than the simulator's discretisation "
            "error could leave. Refine the mesh or the time step."
        )
        return replace(quiet, verdict=verdict, sentence=said)
    if verdict == "partly":
        values |= {
            "sentence": "It is a part of the answer that the gel relaxes: that explains 34 % of the misfit.",
            "explained": 0.34,
        }
    if verdict in ("unknown", "recording_fault"):
        values |= {
            "sentence": "Something is missing that no known effect explains: the forces in contact change while the "
            "robot moves slowly.",
            "effects": (),
            "places": (
                UnreliablePlace("gel", "something is missing in the gel", 0.81),
                UnreliablePlace("wrench", "something is missing in a wrench sensor", 0.35),
            ),
            "alternatives": (
                gel_relaxation(0.3),
                plasticity(0.2),
            ),
            "baseline": Misfit(48.2, 51.7, tuple(make_errors(RUNS, before=9.0, after=7.1))),
            "amended": None,
            "amended_parameters": (),
            "not_explained": "97 % of the excess misfit in wrench_gel force while moving in contact. No law of the "
            "library follows its course.",
            "next_experiment": "Repeat press_1 at a tenth of the speed: whether the misfit follows the path or the "
            "clock decides between dissipation and drift.",
            "series": make_series(RUNS, before=0.3, after=0.3),
        }
    return Diagnosis(**{**values, **changes})  # type: ignore[arg-type]
