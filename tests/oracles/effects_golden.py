#!/usr/bin/env python3
"""Goldens for effects with memory, from SciPy's integrators on textbook equations.

    python3 tests/oracles/effects_golden.py services/physics/tests/golden/effects.json

Needs numpy and scipy. Three laws:

- dahl: delta dz/dt = qd - |qd| z along a path that reverses, at irregular times;
- elasticity of a planar two-link arm (textbook equations of motion, gravity), joint 1, joint 2 or both soft:
  M(q) qdd + h(q, qd) = T with T = k e + d (thetad - qd) at soft joints, e = theta - q, d = 2 zeta sqrt(k M_ii);
  recorded is what the motors feel more than with rigid joints;
- backlash of one link about a vertical axis: T = k (|e| - b) sgn e + d ed while |e| > b, else 0.

The motors follow theta = theta0 + A (1 - cos(w t))^2, at rest at t = 0.
"""

import json
import re
import sys

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

G = 9.81


def drive(p, t):
    """theta, its rate and acceleration, per joint."""
    a, w, start = (np.array(p[k]) for k in ("amplitude", "omega", "start"))
    u, s, c = 1 - np.cos(w * t), np.sin(w * t), np.cos(w * t)
    return start + a * u**2, 2 * a * w * u * s, 2 * a * w**2 * (s**2 + u * c)


def dahl():
    rng = np.random.default_rng(1)
    delta = 0.012
    t = np.concatenate([[0.0], np.cumsum(rng.uniform(0.5e-3, 8e-3, 240))])

    def path(t):
        return 0.02 * np.sin(7 * t) + 0.008 * np.sin(31 * t), 0.14 * np.cos(7 * t) + 0.248 * np.cos(31 * t)

    def rate(t, z):
        qd = path(t)[1]
        return (qd - abs(qd) * z) / delta

    sol = solve_ivp(rate, (0, t[-1]), [0.0], t_eval=t, method="DOP853", rtol=1e-10, atol=1e-12, max_step=2e-4)
    q, qd = path(t)
    return {"delta": delta, "t": t.tolist(), "q": q.tolist(), "qd": qd.tolist(), "z": sol.y[0].tolist()}


def planar(p, q, qd):
    """M(q) and h(q, qd) of a planar two-link arm, angle from x, gravity along -y."""
    (m1, m2), (l1, _), (r1, r2), (i1, i2) = p["mass"], p["length"], p["com"], p["inertia"]
    b, c = m2 * l1 * r2, i2 + m2 * r2**2
    m11 = i1 + m1 * r1**2 + i2 + m2 * (l1**2 + r2**2) + 2 * b * np.cos(q[1])
    m12 = c + b * np.cos(q[1])
    m = np.array([[m11, m12], [m12, c]])
    h = np.array([-b * np.sin(q[1]) * (2 * qd[0] * qd[1] + qd[1] ** 2), b * np.sin(q[1]) * qd[0] ** 2])
    h += G * np.array([(m1 * r1 + m2 * l1) * np.cos(q[0]) + m2 * r2 * np.cos(q[0] + q[1]), m2 * r2 * np.cos(q[0] + q[1])])
    return m, h


def elastic(p, soft):
    soft = np.array(soft)
    k, zeta = p["k"], p["zeta"]

    def state(t, y):
        """Link motion, motor-side torque past the rotors and acceleration of the soft joints."""
        th, thd, thdd = drive(p, t)
        q, qd, qdd = th.copy(), thd.copy(), thdd.copy()
        q[soft], qd[soft] = y[: len(soft)], y[len(soft) :]
        m, h = planar(p, q, qd)
        d = 2 * zeta * np.sqrt(k * np.diag(planar(p, th, thd)[0])[soft])
        spring = k * (th - q)[soft] + d * (thd - qd)[soft]
        stiff = [j for j in range(2) if j not in soft]
        rest = spring - h[soft] - m[np.ix_(soft, stiff)] @ qdd[stiff]
        qdd[soft] = np.linalg.solve(m[np.ix_(soft, soft)], rest)
        return qdd[soft], m @ qdd + h

    th0 = drive(p, 0.0)[0]

    def balance(q_soft):
        q = th0.copy()
        q[soft] = q_soft
        return (k * (th0 - q) - planar(p, q, np.zeros(2))[1])[soft]

    y0 = np.concatenate([fsolve(balance, th0[soft], xtol=1e-12), np.zeros(len(soft))])
    t = np.arange(0, 0.8, 0.004)
    sol = solve_ivp(
        lambda t, y: np.concatenate([y[len(soft) :], state(t, y)[0]]),
        (0, t[-1]), y0, t_eval=t, method="DOP853", rtol=1e-11, atol=1e-13, max_step=1e-3,
    )
    out = []
    for i, ti in enumerate(t):
        th, thd, thdd = drive(p, ti)
        m, h = planar(p, th, thd)
        out.append((state(ti, sol.y[:, i])[1] - m @ thdd - h).tolist())
    return {"soft": soft.tolist(), "every": 4, "dtau": out}


def backlash(p):
    j, k, b, zeta = p["J"], p["k"], p["b"], p["zeta"]
    d = 2 * zeta * np.sqrt(k * j)

    def torque(e, ed):
        return (k * (abs(e) - b) * np.sign(e) + d * ed) * (abs(e) > b)

    def rate(t, y):
        th, thd, _ = (v[0] for v in drive(p, t))
        return [y[1], torque(th - y[0], thd - y[1]) / j]

    t = np.arange(0, 0.8, 0.004)
    y0 = [drive(p, 0.0)[0][0], 0.0]
    sol = solve_ivp(rate, (0, t[-1]), y0, t_eval=t, method="RK45", rtol=1e-9, atol=1e-12, max_step=4e-6)
    th, thd, thdd = (np.array([drive(p, ti)[i][0] for ti in t]) for i in range(3))
    dtau = torque(th - sol.y[0], thd - sol.y[1]) - j * thdd
    return dtau.tolist()


def main():
    arm = {
        "mass": [4.0, 2.5], "length": [0.4, 0.3], "com": [0.25, 0.18], "inertia": [0.05, 0.03], "rotor": [0.1, 0.05],
        "amplitude": [0.12, -0.09], "omega": [14.0, 11.0], "start": [0.4, 0.7], "k": 2500.0, "zeta": 0.05,
    }
    axis = {"J": 0.2, "k": 2e4, "b": 1.5e-3, "zeta": 0.2, "amplitude": [0.1], "omega": [15.0], "start": [0.2]}
    golden = {
        "dahl": dahl(),
        "elasticity": {**arm, "cases": [elastic(arm, s) for s in ([0], [1], [0, 1])]},
        "backlash": {**axis, "every": 4, "dtau": backlash(axis)},
    }
    text = json.dumps(golden)

    text = re.sub(r"-?\d+\.\d{9,}(e-?\d+)?", lambda m: f"{float(m.group()):.10g}", text)
    with open(sys.argv[1], "w") as f:
        f.write(text + "\n")


if __name__ == "__main__":
    main()
