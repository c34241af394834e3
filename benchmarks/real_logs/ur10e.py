"""UR10e: what a load weighs when the log holds currents, by batch and online, with three sets of drive gains."""

import dataclasses
import time
from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from benchmarks.real_logs.logs import UR10E, Setting
from benchmarks.real_logs.ur10e_model import LINKS, makers_model
from jax_inertia.estimation import batch_fit
from jax_inertia.estimation.batch_fit import BatchFit, Calibrated, Carried
from jax_inertia.estimation.inertial_filter import make_estimator
from jax_inertia.estimation.priors import Load, Tolerance
from jax_inertia.maths import charts
from jax_inertia.model.robot import Robot
from jax_inertia.signals.differences import Observation

TRUE_KG = 2.805
WRIST = "wrist_3_link"
FREE = ("dev_free_1", "dev_free_2", "dev_free_3")
PAIR_FREE, PAIR_PAYLOAD = "dev_pair_free", "dev_pair_payload"
REPOSITORY = np.array([10.0, 10.6956, 8.4566, 9.0029, 9.48, 10.1232])
DE_LUCA = np.array([14.87, 13.26, 11.13, 10.62, 11.03, 11.47])
LOAD = Load(3.0, 0.2)


@dataclass(frozen=True)
class Calibration:
    """A way to get gains and bodies: model, how far it is trusted, gains to start from and their freedom."""

    name: str
    model: Robot
    trust: Tolerance
    gains: np.ndarray
    gain_sigma: float

    def fit(self, observations: list[Observation], **options) -> BatchFit:
        """Bodies, joint terms and (where free) gains of the logs."""
        return batch_fit.fit(
            self.model,
            observations,
            LINKS,
            prior=self.trust,
            joint_terms=batch_fit.JOINT_TERMS,
            gains=self.gains,
            gain_sigma=self.gain_sigma,
            **options,
        )

    def weigh(self, free: list[Observation], one: Observation) -> BatchFit:
        """A load on `one` log, in one problem with the calibration on the free logs."""
        return self.fit([*free, one], carried=Carried(WRIST, (len(free),), LOAD))


def calibrations() -> list[Calibration]:
    """Both published gain sets as they are; gains calibrated against the URDF and against the maker's figures."""
    urdf = UR10E.model("model_ur10e.urdf")
    maker = makers_model(urdf)
    middle = np.sqrt(REPOSITORY * DE_LUCA)
    loose, tight = Tolerance(0.1, 0.05), Tolerance(0.03, 0.02)
    return [
        Calibration("repository gains, exact; URDF", urdf, loose, REPOSITORY, 0.0),
        Calibration("De Luca gains, exact; URDF", urdf, loose, DE_LUCA, 0.0),
        Calibration("gains calibrated on the URDF", urdf, loose, middle, 0.5),
        Calibration("gains calibrated on the maker's inertias", maker, tight, middle, 0.5),
    ]


def observe(names: tuple[str, ...], setting: Setting = UR10E) -> list[Observation]:
    """The named logs."""
    robot = setting.model("model_ur10e.urdf")
    return [setting.observation(robot, name) for name in names]


def mass(fit: BatchFit) -> tuple[float, float]:
    """(load [kg], half of its 95 % interval)."""
    assert fit.load is not None
    return float(fit.load.pi[0, 0]), 1.96 * float(fit.load.sigma_pi[0, 0])


@dataclass(frozen=True)
class Weighing:
    """One row of the batch table."""

    calibration: str
    log: str
    value: tuple[float, float]
    com: np.ndarray
    fit: BatchFit
    seconds: float


def weighings() -> list[Weighing]:
    """The pair by every calibration, gains and bodies calibrated on the three free logs."""
    free, pair = observe(FREE), observe((PAIR_FREE, PAIR_PAYLOAD))
    out = []
    for calibration in calibrations():
        for name, log in zip((PAIR_FREE, PAIR_PAYLOAD), pair, strict=True):
            start = time.perf_counter()
            fit = calibration.weigh(free, log)
            seconds = time.perf_counter() - start
            assert fit.load is not None
            out.append(Weighing(calibration.name, name, mass(fit), fit.load.com[0], fit, seconds))
    return out


def held_out() -> list[tuple[str, str, tuple[float, float]]]:
    """No load on each free run, calibrated on the two others."""
    free = observe(FREE)
    return [
        (calibration.name, FREE[k], mass(calibration.weigh(free[:k] + free[k + 1 :], free[k])))
        for calibration in calibrations()
        for k in range(len(free))
    ]


def by_joint() -> list[tuple[str, tuple[float, float]]]:
    """The payload as single joints of its log see it (gains on the maker's inertias)."""
    free, (log,) = observe(FREE), observe((PAIR_PAYLOAD,))
    calibration = calibrations()[-1]
    out = []
    for j, name in enumerate(calibration.model.joint_names[1:5], start=1):
        only = np.zeros(calibration.model.nv, bool)
        only[j] = True
        valid = np.asarray(log.motion.valid) & only
        masked = dataclasses.replace(log, motion=dataclasses.replace(log.motion, valid=valid))
        out.append((name, mass(calibration.weigh(free, masked))))
    return out


def by_setting() -> list[tuple[Setting, tuple[float, float], tuple[float, float]]]:
    """Pair without and with payload for other preparations of the logs (gains on the maker's inertias)."""
    settings = [UR10E]
    settings += [dataclasses.replace(UR10E, slowest=v) for v in (0.0, 0.05, 0.2)]
    settings += [dataclasses.replace(UR10E, cutoff=c) for c in (3.0, 8.0)]
    calibration = calibrations()[-1]
    out = []
    for setting in settings:
        free, pair = observe(FREE, setting), observe((PAIR_FREE, PAIR_PAYLOAD), setting)
        out.append((setting, *(mass(calibration.weigh(free, log)) for log in pair)))
    return out


@dataclass(frozen=True)
class ChartRun:
    """How one chart fared in the calibration."""

    chart: str
    gains: str
    fit: BatchFit
    seconds: float


def chart_race() -> list[ChartRun]:
    """The same calibration, prior and start in every chart; second run of each, so that nothing compiles."""
    free = observe(FREE)
    model = calibrations()[-1].model
    chosen = np.array([model.body_index(name) for name in LINKS])
    every = (
        charts.LogCholeskyUUt(),
        charts.LogCholesky(),
        charts.Relative.to(model.pi[chosen]),
        charts.Linear(),
    )
    out = []
    for sigma, gains in ((0.0, "repository, exact"), (0.5, "free")):
        calibration = dataclasses.replace(calibrations()[-1], gains=REPOSITORY, gain_sigma=sigma)
        for chart in every:
            calibration.fit(free, chart=chart)
            start = time.perf_counter()
            fit = calibration.fit(free, chart=chart)
            seconds = time.perf_counter() - start
            out.append(ChartRun(type(chart).__name__, gains, fit, seconds))
    return out


@dataclass(frozen=True)
class Online:
    """A filter's weighing over a log."""

    calibration: str
    variant: str
    log: str
    value: float
    own: float
    """Half of the 95 % interval at the end of the log, the calibration taken as exact."""
    total: float
    """The same with what the calibration leaves open."""
    seconds: float
    """Of one run over the log, compiled."""
    time: np.ndarray
    trace: np.ndarray
    sigma: np.ndarray


DRAWS = 16
# The load does not change within a log: no process noise, as in the batch fit.
DRIFT = Load(0.0, 0.2)
_VARIANTS = {
    "LogCholesky, 1 iteration": (charts.LogCholesky(), 1),
    "LogCholeskyUUt, 5 iterations": (charts.LogCholeskyUUt(), 5),
}


def online() -> list[Online]:
    """The pair, sample by sample, with models calibrated on the three free logs."""
    free, pair = observe(FREE), observe((PAIR_FREE, PAIR_PAYLOAD))
    out = []
    for calibration in calibrations():
        fit = calibration.fit(free)
        best = Calibrated(fit.robot, fit.gains, fit.bias)
        # Gains that are taken as exact leave bodies and friction open all the same.
        drawn = fit.draws(DRAWS)
        for variant in _VARIANTS:
            for name, log in zip((PAIR_FREE, PAIR_PAYLOAD), pair, strict=True):
                _filter(best, fit, variant, log)
                start = time.perf_counter()
                masses, sigma = _filter(best, fit, variant, log)
                seconds = time.perf_counter() - start
                ends = [_filter(one, fit, variant, log)[0][-1] for one in drawn]
                own = 1.96 * float(sigma[-1])
                total = float(np.hypot(own, 1.96 * np.std(ends, ddof=1)))
                value, when = float(masses[-1]), np.asarray(log.motion.time)
                out.append(
                    Online(
                        calibration.name,
                        variant,
                        name,
                        value,
                        own,
                        total,
                        seconds,
                        when,
                        masses,
                        sigma,
                    )
                )
    return out


def _filter(
    model: Calibrated, fit: BatchFit, variant: str, log: Observation
) -> tuple[np.ndarray, np.ndarray]:
    """(load above the calibrated wrist, its σ) after every sample."""
    chart, iterations = _VARIANTS[variant]
    estimator = make_estimator(
        model.robot,
        [WRIST],
        sigma_tau=fit.noise * model.gains / fit.gains,
        prior=LOAD,
        drift=DRIFT,
        chart=chart,
        iterations=iterations,
        paper=True,  # no gate; of the comparison, chart and iterations are what differs
    )
    state = eqx.tree_at(lambda s: s.bias, estimator.initial(), jnp.asarray(model.bias))
    torque = dataclasses.replace(log.motion, tau=np.asarray(log.motion.tau) * model.gains, notes=())
    _, estimate = _run(estimator, state, dataclasses.replace(log, motion=torque))
    own = float(model.robot.pi[model.robot.body_index(WRIST), 0])
    return np.asarray(estimate.pi[:, 0, 0]) - own, np.asarray(estimate.sigma_pi[:, 0, 0])


@eqx.filter_jit
def _run(estimator, state, observation):
    state, trace = estimator.run(state, observation)
    return state, trace.estimate
