#!/usr/bin/env python3
"""Links that could exist, by Clarabel: the optimum of problems that the constrained fit solved by its own method.

    python3 tests/oracles/consistent_fit.py PROBLEM.json…

    minimise  ½ βᵀAβ − cᵀβ,   β = the first entries of z,   P_i(T z) positive semidefinite

Prints the optimal values as a JSON list. Needs numpy, scipy and clarabel; exit code 77 without them.
"""

import json
import sys

try:
    import clarabel
    import numpy as np
    from scipy import sparse
except ImportError as e:
    print(e, file=sys.stderr)
    sys.exit(77)


def optimum(problem):
    a, c, t = (np.array(problem[k]) for k in "act")
    base, count = len(c), len(t)
    # Columns of a like size: base parameters by their curvature.
    scale = np.ones(count)
    scale[:base] = 1 / np.sqrt(np.diag(a))
    size = abs(c * scale[:base]).max()
    p = np.zeros((count, count))
    p[:base, :base] = a * np.outer(scale[:base], scale[:base])
    q = np.zeros(count)
    q[:base] = c * scale[:base]
    # With x = z/(scale size) the objective is size² times ½ xᵀP x − qᵀx/size.
    rows, cones = [], []
    for cone in problem["cones"]:
        n = cone["size"]
        # P in terms of x, entry by entry of the upper triangle, column by column.
        for k in range(n):
            for i in range(k + 1):
                entry = sum(part["matrix"][i][k] * t[part["variable"]] for part in cone["parts"])
                rows.append(entry * scale * (1 if i == k else np.sqrt(2)))
        cones.append(clarabel.PSDTriangleConeT(n) if n > 1 else clarabel.NonnegativeConeT(1))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_iter = 500
    solver = clarabel.DefaultSolver(
        sparse.csc_matrix(np.triu(p)), -q / size, sparse.csc_matrix(-np.array(rows)), np.zeros(len(rows)), cones, settings
    )
    solution = solver.solve()
    if str(solution.status) not in ("Solved", "AlmostSolved"):
        raise SystemExit(f"clarabel: {solution.status}")
    return solution.obj_val * size**2


if __name__ == "__main__":
    print(json.dumps([optimum(json.load(open(path, encoding="utf-8"))) for path in sys.argv[1:]]))
