"""Judges of paper 000 on network and observer with an ideal actuator."""

from __future__ import annotations

import numpy as np

from train_ato.control.laws.rbf_smc import RbfSmcParameters
from train_ato.messages.types import Array
from train_ato.papers.bounds import BETTER, REMOVED, Bound, ratio
from train_ato.papers.checks import conclude, recording, rms_kmh, variation
from train_ato.papers.claims import THREE, Claims, Judgement, Result, Results
from train_ato.papers.p000_heavy_haul.cases import PERIOD, PRINTED_NETWORK
from train_ato.papers.p000_heavy_haul.series import (
    LOCOMOTIVE,
    disturbance_40,
    network_estimate,
    unexplained,
)

CLAIMS = Claims()
SETTLED = 5.0
"""Begin of the comparison of series, after the start of train and filters [s]."""
DELTA = Bound("rms error of delta", 5e-5, "m/s²", "paper")
DELTA_KS = Bound("rms error of delta with ks", 5e-5, "m/s²", "paper")
PRECISE = ratio("rms miss over rms truth, 1000 1/s", REMOVED, "paper: precisely")
PRECISE_SLOW = ratio("rms miss over rms truth, 20 1/s", REMOVED, "paper: precisely")
HELPS = ratio("rms RBFNN over SMC at f/1.01", BETTER, "implied: improves")
HELPS_BECAUSE = ratio("that ratio over the one with exact f", 1.0, "implied: because f is wrong")
HELPS_KS = ratio("rms RBFNN over SMC at f/1.01, both with ks", BETTER, "implied: improves")


@CLAIMS.judged_by("the network estimates delta", "within 5e-5 m/s²", ("rbf", "rbf_ks"), THREE)
def network_accuracy(results: Results) -> Judgement:
    """Judge the accuracy of the network, 5e-5 m/s² for delta."""
    printed = _network_errors(results["rbf"], _network(0.0, False))
    repaired = _network_errors(results["rbf_ks"], RbfSmcParameters())
    size = float(np.std(unexplained(recording(results["rbf"]), PERIOD, 0.01)))
    rms_printed, rms_repaired = (float(np.sqrt(np.mean(errors**2))) for errors in (printed, repaired))
    share = 100.0 * float(np.mean(np.abs(repaired) <= 5e-5))
    text = f"rms {rms_printed:.1e} m/s² as printed, {rms_repaired:.1e} with ks and clipped inputs"
    pull = results["rbf"].summary["coupler_draft_max_kn"]
    reason = (
        f"delta = 0.0099 f itself has {size:.1e} m/s² rms, because f contains the force of the first coupler, up to "
        f"{pull:.0f} kN on 184 t; learning at 0.01 S h cannot follow it (within 5e-5 in {share:.1f} % of the time)"
    )
    return conclude(text, [DELTA.check(rms_printed)], reason, elsewhere=[DELTA_KS.check(rms_repaired)])


def _network_errors(result: Result, parameters: RbfSmcParameters) -> Array:
    run = recording(result)
    error = network_estimate(run, parameters, PERIOD) - unexplained(run, PERIOD, 0.01)
    return np.asarray(error[run.time > SETTLED])


def _network(ks: float, clip: bool) -> RbfSmcParameters:
    return RbfSmcParameters(**{**PRINTED_NETWORK, "ks": ks, "clip": clip})  # type: ignore[arg-type]


def _miss(time: Array, found: Array, truth: Array) -> float:
    later = time > SETTLED
    return float(np.sqrt(np.mean((found - truth)[later] ** 2)))


@CLAIMS.judged_by(
    "the NDO observes the fast disturbance",
    "precisely",
    ("rbf_ndo disturbed", "rbf_ks_ndo disturbed", "ndo 1000 noise", "ndo 20 noise"),
    THREE,
)
def estimate_accuracy(results: Results) -> Judgement:
    """Judge the accuracy of the observer for the fast disturbance."""
    texts, shares = [], []
    for key, label in (("rbf_ndo disturbed", "1000"), ("rbf_ks_ndo disturbed", "20")):
        run = recording(results[key])
        truth = unexplained(run, PERIOD, 0.01, disturbance_40(run, PERIOD))
        miss, size = _miss(run.time, run.estimate[:, 0] / LOCOMOTIVE, truth), float(np.std(truth))
        shares.append(miss / size)
        texts.append(f"{miss:.1e} at {label} 1/s")
    noisy = rms_kmh(results["ndo 1000 noise"]) / rms_kmh(results["ndo 20 noise"])
    forces = [variation(results[f"ndo {omega} noise"]) for omega in (1000, 20)]
    reason = (
        f"truth (disturbance and model error of the locomotive) {size:.1e} m/s² rms; the estimate is a sample late; "
        f"with 0.01 m/s of speed noise 1000 1/s costs {noisy:.1f} times the error of 20 1/s "
        f"and {forces[0]:.0f} kN/s of "
        f"command against {forces[1]:.0f}"
    )
    return conclude(
        f"rms miss {', '.join(texts)} m/s²",
        [PRECISE.check(shares[0])],
        reason,
        elsewhere=[PRECISE_SLOW.check(shares[1])],
    )


@CLAIMS.judged_by(
    "the network improves SMC because f is 1 % wrong",
    "implied",
    ("smc", "rbf", "smc exact", "rbf exact", "smc_ks", "rbf_ks"),
    THREE,
)
def exact_model(results: Results) -> Judgement:
    """Judge the dependence of the benefit of the network on the 1 % model error."""
    pairs = (("smc", "rbf"), ("smc exact", "rbf exact"), ("smc_ks", "rbf_ks"))
    wrong, right, repaired = (rms_kmh(results[network]) / rms_kmh(results[plain]) for plain, network in pairs)
    texts = [f"{rms_kmh(results[plain]):.4f}, {rms_kmh(results[network]):.4f}" for plain, network in pairs]
    text = f"SMC, RBFNN: f/1.01 {texts[0]}; f exact {texts[1]}; f/1.01 and ks {texts[2]} km/h rms"
    unknown = 0.01 * results["smc"].summary["coupler_draft_max_kn"] * 1e3 / LOCOMOTIVE
    reason = (
        f"the printed network changes the rms of SMC to {100 * wrong:.0f} % with a wrong f and to {100 * right:.0f} % "
        f"with an exact one (as additional integral action): because of FC_0, 1 % of f is up to {unknown:.2f} m/s², "
        f"much for its five narrow basis functions. Beside a restoring term ks S it has {100 * repaired:.0f} %"
    )
    return conclude(
        text,
        [HELPS.check(wrong), HELPS_BECAUSE.check(wrong / right)],
        "as stated",
        elsewhere=[HELPS_KS.check(repaired)],
        changed=reason,
        otherwise=reason,
    )
