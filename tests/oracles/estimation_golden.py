#!/usr/bin/env python3
"""Goldens of lacuna-estimation from numpy and scipy: filters, interpolation, least squares, Kalman smoothing.

    python3 tests/oracles/estimation_golden.py

writes services/estimation/tests/golden/*.json. The smoother's golden is not a Kalman smoother at all: it is
the weighted least-squares problem that the smoother solves, written down for all samples at once and solved
by QR; its covariance is the inverse of the normal matrix.
"""
import json
import math
from pathlib import Path

import numpy as np
import scipy.interpolate
import scipy.linalg
import scipy.ndimage
import scipy.optimize
import scipy.signal

OUT = Path(__file__).resolve().parents[2] / "services/estimation/tests/golden"


def write(name, data):
    OUT.mkdir(parents=True, exist_ok=True)
    (OUT / name).write_text(json.dumps(data, separators=(",", ":")) + "\n")


def numbers(x):
    return np.asarray(x, dtype=float).tolist()


def filters():
    rng = np.random.default_rng(1)
    n = 80
    x = np.cumsum(rng.normal(size=n)) + 5.0
    low_pass = []
    for order, cutoff, rate in [(1, 10.0, 100.0), (2, 3.0, 100.0), (3, 20.0, 100.0), (4, 40.0, 1000.0), (5, 8.0, 250.0), (8, 30.0, 100.0)]:
        sos = scipy.signal.butter(order, cutoff, fs=rate, output="sos")
        y = scipy.signal.sosfiltfilt(sos, x)
        low_pass.append({"order": order, "cutoff_hz": cutoff, "rate_hz": rate, "y": numbers(y)})
    t = np.cumsum(rng.uniform(0.5, 1.5, size=25)) * 1e-2
    v = rng.normal(size=25)
    grid = np.linspace(t[0], t[-1], 40)
    write("filter.json", {
        "x": numbers(x), "low_pass": low_pass,
        "median": [{"window": w, "y": numbers(scipy.ndimage.median_filter(x, w, mode="nearest"))} for w in (3, 9)],
        "t": numbers(t), "v": numbers(v), "grid": numbers(grid),
        "cubic": numbers(scipy.interpolate.CubicSpline(t, v, bc_type="natural")(grid)),
        "linear": numbers(np.interp(grid, t, v)),
    })


def newey_west(x, e, bread, lags):
    n, p = x.shape
    u = x * e[:, None]
    s = u.T @ u
    for lag in range(1, lags + 1):
        g = u[lag:].T @ u[:-lag]
        s += (1 - lag / (lags + 1)) * (g + g.T)
    return bread @ s @ bread * n / (n - p)


def least_squares():
    rng = np.random.default_rng(2)
    n, p = 60, 4
    x = rng.normal(size=(n, p)) * [1.0, 1e3, 1e-4, 10.0]
    x[:, 3] += 5 * x[:, 0]
    beta = np.array([1.5, -2e-3, 4e4, 0.3])
    e = scipy.signal.lfilter([1.0], [1.0, -0.6], rng.normal(size=n)) * 0.2
    y = x @ beta + e
    w = rng.uniform(0.2, 3.0, size=n)
    # numpy does not scale columns; unscaled, it would lose the digits of this golden.
    norm = np.linalg.norm(x, axis=0)
    fit = np.linalg.lstsq(x / norm, y, rcond=None)[0] / norm
    residual = y - x @ fit
    sigma2 = residual @ residual / (n - p)
    bread = np.linalg.inv((x / norm).T @ (x / norm)) / np.outer(norm, norm)
    cov = sigma2 * bread
    root = np.sqrt(w)
    weighted = np.linalg.lstsq(x / norm * root[:, None], y * root, rcond=None)[0] / norm
    # Outliers for the robust fits; Huber by direct minimisation of its loss at the scale IRLS ends with.
    spoiled = y.copy()
    spoiled[[3, 17, 40]] += [8.0, -11.0, 6.0]
    scaled = x / norm

    def huber_at(scale, start):
        def loss(b):
            u = np.abs((spoiled - scaled @ b) / scale)
            return np.sum(np.where(u <= 1.345, 0.5 * u * u, 1.345 * u - 0.5 * 1.345 ** 2))
        b = start
        for _ in range(5):
            b = scipy.optimize.minimize(loss, b, method="BFGS", options={"gtol": 1e-12}).x
            b = scipy.optimize.minimize(loss, b, method="Nelder-Mead", options={"xatol": 1e-12, "fatol": 1e-15, "maxiter": 20000}).x
        return b

    b = np.linalg.lstsq(scaled, spoiled, rcond=None)[0]
    for _ in range(60):
        scale = 1.482602218505602 * np.median(np.abs(spoiled - scaled @ b))
        b_next = huber_at(scale, b)
        if np.max(np.abs(b_next - b)) < 1e-12:
            break
        b = b_next
    write("least_squares.json", {
        "x": numbers(x), "y": numbers(y), "weights": numbers(w), "beta": numbers(fit), "sigma": float(np.sqrt(sigma2)),
        "covariance": numbers(cov), "condition": float(np.linalg.cond(scaled)), "weighted": numbers(weighted),
        "lags": 5, "newey_west": numbers(newey_west(x, residual, bread, 5)),
        "spoiled": numbers(spoiled), "huber": numbers(b / norm), "huber_scale": float(scale),
    })


def chain(order, q, dt):
    """F and Q of an integrator chain by Van Loan's matrix exponential (not by the closed form)."""
    a = np.diag(np.ones(order - 1), 1)
    g = np.zeros((order, order))
    g[-1, -1] = q
    m = scipy.linalg.expm(np.block([[-a, g], [np.zeros_like(a), a.T]]) * dt)
    f = m[order:, order:].T
    return f, f @ m[:order, order:]


def batch_smoother(order, t, z, q, r):
    n = len(t)
    rows, right = [], []
    for k in range(n):
        row = np.zeros(n * order)
        row[k * order] = 1 / math.sqrt(r)
        rows.append(row)
        right.append(z[k] / math.sqrt(r))
    for k in range(n - 1):
        f, cov = chain(order, q, t[k + 1] - t[k])
        white = np.linalg.inv(np.linalg.cholesky(cov))
        block = np.zeros((order, n * order))
        block[:, k * order:(k + 1) * order] = -white @ f
        block[:, (k + 1) * order:(k + 2) * order] = white
        rows.extend(block)
        right.extend(np.zeros(order))
    a, b = np.array(rows), np.array(right)
    scale = np.linalg.norm(a, axis=0)
    qm, rm = np.linalg.qr(a / scale)
    x = scipy.linalg.solve_triangular(rm, qm.T @ b) / scale
    inv = scipy.linalg.solve_triangular(rm, np.eye(n * order))
    sd = np.sqrt(np.sum(inv ** 2, axis=1)) / scale
    return x.reshape(n, order)[:, :3], sd.reshape(n, order)[:, :3]


def kalman():
    rng = np.random.default_rng(3)
    cases = []
    for order, q, r in [(3, 4.0, 1e-4), (3, 1e3, 1e-6), (4, 50.0, 1e-4)]:
        for irregular in (False, True):
            n = 24
            dt = rng.uniform(0.02, 0.12, size=n - 1) if irregular else np.full(n - 1, 0.05)
            t = 3.0 + np.concatenate([[0.0], np.cumsum(dt)])
            z = 0.4 + np.sin(2.0 * t) + math.sqrt(r) * rng.normal(size=n)
            x, sd = batch_smoother(order, t, z, q, r)
            cases.append({"order": order, "q": q, "r": r, "t": numbers(t), "z": numbers(z),
                          "x": numbers(x.T), "sd": numbers(sd.T)})
    write("kalman.json", {"cases": cases})


if __name__ == "__main__":
    filters()
    least_squares()
    kalman()
