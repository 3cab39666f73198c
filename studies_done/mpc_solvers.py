"""Solvers of the quadratic programme of the law mpc on the recorded problems of one run.

    python studies_done/mpc_solvers.py [--scenario NAME] [--every N] [--json]

Every N-th problem with an active limit is solved by block principal pivoting of the dual (the law), PIQP, Clarabel and
OSQP, each at its default settings except the tolerance 1e-6. The programme of the last three has the softness of the
limits as slack variables: min 1/2 z'Hz - f'z + 1/2 s'S^-1 s, A z - s <= b. Row: median and 99th percentile of
the time, median and largest number of iterations, number of problems with status solved, and the largest difference of
the first decision from that of the law. Own and OSQP start from the last solution, the others from nothing.

Needs: pip install osqp clarabel piqp
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module
from typing import Any
from unittest.mock import patch

import numpy as np
import scipy.sparse as sp

import train_ato as ta
from train_ato.control.mpc.force_plan import ForcePlan
from train_ato.control.mpc.predictive_plan import PlanStart, decide, free_errors

TOLERANCE = 1e-6
"""Absolute tolerance of the iterative solvers."""
Problem = dict[str, Any]
Solution = tuple[float, int, bool]


def record(scenario: str) -> list[Problem]:
    """Return the problems with an active limit of a run, in order."""
    problems: list[Problem] = []
    decided = ForcePlan.decide

    def recording(plan: Any, start: PlanStart, ahead: Any, *, simulated: bool) -> float:
        before = plan._active.copy()
        force = decided(plan, start, ahead, simulated=simulated)
        if plan._active.any():
            side = plan._sides[int(start.last_force < 0.0)]
            errors = free_errors(start.motion, plan.nodes, plan._model.lag)
            problems.append({"side": side, "errors": errors, "b": plan.allowed.ravel().copy(), "active": before})
        return force

    with patch.object(ForcePlan, "decide", recording):
        ta.run(scenario, law="mpc", compensation="none", progress=True)
    return problems


def programme(problem: Problem) -> tuple[Any, Any, Any, Any]:
    """Return P, q, G and h of min 1/2 x'Px + q'x, G x <= h, with x = (z, s)."""
    side, errors = problem["side"], problem["errors"]
    rows, hessian = side.constraints, np.linalg.inv(side.inverse)
    softness = side.dual - rows @ side.inverse @ rows.T
    force = -side.gradient_position @ errors.position - side.gradient_velocity @ errors.velocity
    quadratic = sp.block_diag((0.5 * (hessian + hessian.T), np.linalg.inv(0.5 * (softness + softness.T))), format="csc")
    constraints = sp.hstack((sp.csc_matrix(rows), -sp.identity(rows.shape[0])), format="csc")
    return quadratic, np.concatenate((-force, np.zeros(rows.shape[0]))), constraints, problem["b"]


def own(problem: Problem) -> Solution:
    """Solve by the law; the time includes the response to the errors."""
    z = np.zeros(problem["errors"].position.size)
    active = problem["active"].copy()
    exchanges = decide(problem["side"], problem["errors"], problem["b"], active, z)
    return float(z[0]), exchanges, exchanges >= 0


def piqp_solution(problem: Problem) -> Callable[[], Solution]:
    """Return the call that solves with PIQP; the set-up is not part of it."""
    piqp: Any = import_module("piqp")

    quadratic, linear, constraints, upper = problem["programme"]
    solver = piqp.SparseSolver()
    solver.settings.eps_abs = TOLERANCE
    solver.setup(quadratic, linear, None, None, constraints, np.full(upper.size, -1e30), upper)

    def call() -> Solution:
        status = solver.solve()
        return float(solver.result.x[0]), int(solver.result.info.iter), status == piqp.PIQP_SOLVED

    return call


def clarabel_solution(problem: Problem) -> Callable[[], Solution]:
    """Return the call that solves with Clarabel; the set-up is not part of it."""
    clarabel: Any = import_module("clarabel")

    quadratic, linear, constraints, upper = problem["programme"]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_feas = TOLERANCE
    cones = [clarabel.NonnegativeConeT(upper.size)]
    solver = clarabel.DefaultSolver(sp.triu(quadratic).tocsc(), linear, constraints, upper, cones, settings)

    def call() -> Solution:
        found = solver.solve()
        return float(found.x[0]), int(found.iterations), str(found.status) == "Solved"

    return call


def osqp_solutions(problems: list[Problem]) -> Iterator[Callable[[], Solution]]:
    """Yield the calls that solve with OSQP; a solver with the same matrices starts from its last solution."""
    osqp: Any = import_module("osqp")

    solvers: dict[int, Any] = {}
    for problem in problems:
        quadratic, linear, constraints, upper = problem["programme"]
        key = id(problem["side"])
        if key not in solvers:
            solvers[key] = osqp.OSQP()
            solvers[key].setup(
                sp.triu(quadratic).tocsc(), linear, constraints, np.full(upper.size, -np.inf), upper, verbose=False,
                eps_abs=TOLERANCE, eps_rel=TOLERANCE,
            )  # fmt: skip

        def call(solver: Any = solvers[key], linear: Any = linear, upper: Any = upper) -> Solution:
            solver.update(q=linear, u=upper)
            found = solver.solve()
            return float(found.x[0]), int(found.info.iter), found.info.status == "solved"

        yield call


def row(name: str, calls: Iterator[Callable[[], Solution]], decisions: list[float]) -> dict[str, Any]:
    """Return times [us], iterations, problems solved and the largest difference of the decision [m/s²]."""
    times, iterations, solved, differences = [], [], 0, []
    for call, decision in zip(calls, decisions, strict=True):
        begin = time.perf_counter()
        found, count, good = call()
        times.append(1e6 * (time.perf_counter() - begin))
        iterations.append(count)
        solved += good
        differences.append(abs(found - decision))
    return {
        "solver": name, "problems": len(times), "solved": solved,
        "median_us": float(np.median(times)), "p99_us": float(np.quantile(times, 0.99)),
        "iterations_median": float(np.median(iterations)), "iterations_largest": max(iterations),
        "difference_m_s2": max(differences),
    }  # fmt: skip


def main() -> None:
    """Print the table as Markdown, or one JSON value."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", default="crh380a_gpc:short+limited")
    parser.add_argument("--every", type=int, default=10, metavar="N")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    problems = record(options.scenario)[:: max(1, options.every)]
    for problem in problems:
        problem["programme"] = programme(problem)
    decisions = [own(problem)[0] for problem in problems]
    rows = [
        row("own", (partial(own, problem) for problem in problems), decisions),
        row("PIQP", map(piqp_solution, problems), decisions),
        row("Clarabel", map(clarabel_solution, problems), decisions),
        row("OSQP", osqp_solutions(problems), decisions),
    ]
    if options.json:
        print(json.dumps(rows, indent=1))
        return
    print("| " + " | ".join(rows[0]) + " |")
    print("|---" * len(rows[0]) + "|")
    for each in rows:
        print("| " + " | ".join(f"{v:.3g}" if isinstance(v, float) else str(v) for v in each.values()) + " |")


if __name__ == "__main__":
    main()
