"""Strictly convex quadratic programme with soft linear constraints, by block principal pivoting on its dual.

    min 1/2 z'Hz - f'z + 1/2 sum s_i²/rho_i,   A z <= b + s

The dual problem has multipliers y >= 0 with w = b - A H⁻¹f + (A H⁻¹A' + diag(rho)) y >= 0 and y'w = 0. It is a linear
complementarity problem with a positive definite matrix P. It always has one solution, so that the programme is never
infeasible. P depends only on the model and is computed once.

Block principal pivoting (Judice and Pires 1994, Computers & Operations Research 21) exchanges all rows of wrong sign at
once, beginning with the active rows of the last solution. After three exchanges without progress, the method of Lawson
and Hanson (1974, Solving Least Squares Problems, chapter 23) exchanges one row at a time. The dual cost decreases with
every row. The method is therefore finite for every such P.
"""

# mypy: allow-untyped-defs

from math import sqrt

import numpy as np

from plant_sim.compiled import compiled

MAX_EXCHANGES = 200
"""Largest number of exchanges of one solution; a bound on steps, not on time, so that runs repeat."""
TOLERANCE = 1e-9
"""Largest violation of a sign, over the largest entry of the right-hand side."""


@compiled
def cholesky(matrix):
    """Return the lower Cholesky factor of a positive definite matrix; a plain loop with the same bits everywhere."""
    n = matrix.shape[0]
    lower = np.zeros((n, n))
    for j in range(n):
        for i in range(j, n):
            total = matrix[i, j]
            for k in range(j):
                total -= lower[i, k] * lower[j, k]
            lower[i, j] = sqrt(total) if i == j else total / lower[j, j]
    return lower


@compiled
def solve_factored(lower, right):
    """Replace ``right`` by the solution x of L L' x = right."""
    n = lower.shape[0]
    for i in range(n):
        for k in range(i):
            right[i] -= lower[i, k] * right[k]
        right[i] /= lower[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            right[i] -= lower[k, i] * right[k]
        right[i] /= lower[i, i]


@compiled
def inverse(matrix):
    """Return the inverse of a positive definite matrix."""
    n = matrix.shape[0]
    lower, found = cholesky(matrix), np.zeros((n, n))
    for j in range(n):
        column = np.zeros(n)
        column[j] = 1.0
        solve_factored(lower, column)
        found[:, j] = column
    return found


@compiled
def multipliers(matrix, slack, active, found):
    """Compute the multipliers y >= 0 with w = slack + P y >= 0 and y'w = 0.

    Parameters
    ----------
    matrix : Array, shape (m, m)
        P, positive definite.
    slack : Array, shape (m,)
        Distance of every constraint from its bound without multipliers; < 0 is a violation.
    active : Array of bool, shape (m,)
        Rows with a multiplier: start and result.
    found : Array, shape (m,)
        Result y.

    Returns
    -------
    int
        Number of exchanges; -1 if there are more than :data:`MAX_EXCHANGES`, and ``found`` is then not valid.
    """
    m = slack.size
    largest = 0.0
    for i in range(m):
        largest = max(largest, abs(slack[i]))
    edge = TOLERANCE * largest
    rows = np.empty(m, np.int64)
    wrong = np.empty(m, np.int64)
    fewest, chances = m + 1, 3
    for exchange in range(MAX_EXCHANGES):
        _solve_active(matrix, slack, active, rows, found)
        count = _wrong_signs(matrix, slack, active, rows, found, edge, wrong)
        if count == 0:
            return exchange
        if count < fewest:
            fewest, chances = count, 3
        elif chances > 0:
            chances -= 1
        else:
            return _single_exchanges(matrix, slack, active, rows, found, edge, exchange)
        for k in range(count):
            active[wrong[k]] = not active[wrong[k]]
    return -1


@compiled
def _single_exchanges(matrix, slack, active, rows, found, edge, exchanges):
    """Continue with one row at a time and a smaller dual cost in every exchange; arguments as in `multipliers`."""
    m = slack.size
    feasible = np.zeros(m)
    for i in range(m):
        active[i] = active[i] and found[i] > 0.0
    while exchanges < MAX_EXCHANGES:
        exchanges += 1
        _solve_active(matrix, slack, active, rows, found)
        part, first = 1.0, -1
        for i in range(m):
            if active[i] and found[i] < 0.0:
                reached = feasible[i] / (feasible[i] - found[i])
                if first < 0 or reached < part:
                    part, first = reached, i
        for i in range(m):
            feasible[i] = max(feasible[i] + part * (found[i] - feasible[i]), 0.0) if active[i] else 0.0
        if first >= 0:
            active[first] = False
            feasible[first] = 0.0
            continue
        farthest = _most_violated(matrix, slack, active, found, edge)
        if farthest < 0:
            return exchanges
        active[farthest] = True
    return -1


@compiled
def _most_violated(matrix, slack, active, found, edge):
    """Return the row outside the active ones with the largest violation over the root of its diagonal; -1 for none."""
    m = slack.size
    distance = slack.copy()
    for k in range(m):
        if found[k] != 0.0:
            for i in range(m):
                distance[i] += matrix[i, k] * found[k]
    farthest, most = -1, 0.0
    for i in range(m):
        if not active[i] and distance[i] < -edge:
            violation = -distance[i] / sqrt(matrix[i, i])
            if violation > most:
                farthest, most = i, violation
    return farthest


@compiled
def _solve_active(matrix, slack, active, rows, found):
    """Compute the multipliers of the active rows for w = 0 there; the others are 0."""
    count = 0
    for i in range(slack.size):
        found[i] = 0.0
        if active[i]:
            rows[count] = i
            count += 1
    if count == 0:
        return
    part, right = np.empty((count, count)), np.empty(count)
    for a in range(count):
        right[a] = -slack[rows[a]]
        for b in range(count):
            part[a, b] = matrix[rows[a], rows[b]]
    solve_factored(cholesky(part), right)
    for a in range(count):
        found[rows[a]] = right[a]


@compiled
def _wrong_signs(matrix, slack, active, rows, found, edge, wrong):
    """Return the number of rows with y < 0 or w < 0 and list them in ``wrong``."""
    count, used = 0, 0
    for i in range(slack.size):
        used += active[i]
    for i in range(slack.size):
        if active[i]:
            bad = found[i] < 0.0
        else:
            distance = slack[i]
            for a in range(used):
                distance += matrix[i, rows[a]] * found[rows[a]]
            bad = distance < -edge
        if bad:
            wrong[count] = i
            count += 1
    return count
