"""Writes the frozen vectors beside it from the numbered equations of the paper, sharing nothing with truestroke.

    python tests/vectors/generate.py

Play, dead zones, models and their inverse in exact fractions: (10)-(12) are checked here, without rounding, to undo
(8). The loop of Sec. 3.3 in mpmath with 50 digits. Inputs are doubles; results are the doubles nearest to the truth.
"""

import json
import random
from fractions import Fraction
from pathlib import Path

import mpmath as mp

mp.mp.dps = 50


def H(x, r, y):  # (1)
    return [max(x - r_i, min(x + r_i, y_i)) for r_i, y_i in zip(r, y, strict=True)]


def S(y, d):  # (4)
    return [max(y - d_i, 0) if d_i > 0 else y for d_i in d]


def dot(a, b):  # (3), (5)
    return sum(p * q for p, q in zip(a, b, strict=True))


def inverse_weights(w):  # (10)
    return [1 / w[0]] + [-w[i] / (sum(w[: i + 1]) * sum(w[:i])) for i in range(1, len(w))]


def inverse_thresholds(w, r):  # (10)
    return [sum(w[j] * (r[i] - r[j]) for j in range(i + 1)) for i in range(len(w))]


def inverse_states(w, y):  # (10), with y0_i in the first sum (reading.md)
    return [
        sum(w[j] * y[i] for j in range(i + 1)) + sum(w[j] * y[j] for j in range(i + 1, len(w))) for i in range(len(w))
    ]


def rate_weights(a, b, c_b, zdot):  # (7), scaled as (20)
    return [a_i + c_b * zdot * b_i for a_i, b_i in zip(a, b, strict=True)]


def admissible(w):
    return all(sum(w[: i + 1]) > 0 for i in range(len(w)))


def numbers(rng, low, high, n):
    return [round(rng.uniform(low, high), 4) for _ in range(n)]


def thresholds(rng, n, last):
    return [0.0, *sorted(numbers(rng, 0.02, last, n - 1))]


def exact(values):
    return [Fraction(v) for v in values]


def doubles(values):
    return [float(v) for v in values]


def model(rng, n, m):
    """Random admissible parameters, a and b such that a + c_b zdot b is admissible for |zdot| <= 300 um/s."""
    c_b = 0.007
    while True:
        a, b, w_s = numbers(rng, -2, 4, n), numbers(rng, -1, 1, n), [1.0, *numbers(rng, -0.3, 0.3, m - 1)]
        a[0] += 6.0
        at_bounds = (rate_weights(exact(a), exact(b), Fraction(c_b), v) for v in (-300, 300))
        if all(min(sum(w[: i + 1]) for i in range(n)) > Fraction(1, 2) for w in at_bounds) and admissible(w_s):
            return {"r": thresholds(rng, n, 1.4), "a": a, "b": b, "c_b": c_b, "d": thresholds(rng, m, 20), "w_s": w_s}


def forward_case(rng, n, m, ticks=40):
    case = model(rng, n, m) | {
        "y0": [0.0] * n,
        "x": numbers(rng, -0.6, 3.6, ticks),
        "zdot_d": numbers(rng, -300, 300, ticks),
    }
    r, a, b, d, w_s, y = (exact(case[k]) for k in ("r", "a", "b", "d", "w_s", "y0"))
    states, y3, z5, z8 = [], [], [], []
    for x, zdot in zip(exact(case["x"]), exact(case["zdot_d"]), strict=True):
        y = H(x, r, y)
        states.append(doubles(y))
        y3.append(float(dot(a, y)))
        z5.append(float(dot(w_s, S(dot(a, y), d))))
        z8.append(float(dot(w_s, S(dot(rate_weights(a, b, Fraction(case["c_b"]), zdot), y), d))))
    return case | {"states": states, "y_3": y3, "z_5": z5, "z_8": z8}


def inverse_case(rng, n, m, ticks=40):
    """The weights w_h(zdot_d) change at every tick."""
    case = model(rng, n, m) | {
        "y0": [0.0] * n,
        "z_d": numbers(rng, 0, 30, ticks),
        "zdot_d": numbers(rng, -300, 300, ticks),
    }
    r, a, b, d, w_s, y = (exact(case[k]) for k in ("r", "a", "b", "d", "w_s", "y0"))
    w_s1, d1 = inverse_weights(w_s), inverse_thresholds(w_s, d)
    parameters, y_d, x = [], [], []
    for z, zdot in zip(exact(case["z_d"]), exact(case["zdot_d"]), strict=True):
        w = rate_weights(a, b, Fraction(case["c_b"]), zdot)
        w1, r1, y1 = inverse_weights(w), inverse_thresholds(w, r), inverse_states(w, y)
        y_d.append(dot(w_s1, S(z, d1)))  # (11)
        x.append(dot(w1, H(y_d[-1], r1, y1)))  # (12)
        y = H(x[-1], r, y)
        assert dot(w_s, S(dot(w, y), d)) == z, "(10)-(12) must undo (8) without any remainder"
        parameters.append([doubles(w1), doubles(r1), doubles(y1)])
    inverse = {"inverse_w_s": doubles(w_s1), "inverse_d": doubles(d1), "inverse_parameters": parameters}
    return case | inverse | {"y_d": doubles(y_d), "x": doubles(x)}


def loop_case(rng, n, ticks=32):
    """Sec. 3.3 with lambda = 0.99: command by (10)-(12), measurement of another model plus noise, weights by (23)."""
    plant = model(rng, n, 1)
    case = {"r": plant["r"], "c_b": 0.007, "lambda": 0.99, "delta": 0.125, "w0": [8.0] + [0.0] * (2 * n - 1)}
    case |= {"z_d": numbers(rng, 0, 30, ticks), "zdot_d": numbers(rng, -100, 100, ticks), "z_a": []}
    r, c_b, lam, delta = [mp.mpf(v) for v in case["r"]], *(mp.mpf(case[k]) for k in ("c_b", "lambda", "delta"))
    a_p, b_p = ([mp.mpf(v) for v in plant[k]] for k in ("a", "b"))
    w, P, y = mp.matrix(case["w0"]), mp.eye(2 * n) / delta, [mp.mpf(0)] * n  # (22)
    volts, errors, weights = [], [], []
    for z_d, zdot in zip(case["z_d"], case["zdot_d"], strict=True):
        w_h = rate_weights(list(w[0::2]), list(w[1::2]), c_b, mp.mpf(zdot))
        assert admissible(w_h)
        x = dot(inverse_weights(w_h), H(mp.mpf(z_d), inverse_thresholds(w_h, r), inverse_states(w_h, y)))
        y = H(x, r, y)
        z_a = float(dot(rate_weights(a_p, b_p, c_b, mp.mpf(zdot)), y) + mp.mpf(rng.gauss(0, 0.05)))
        u = mp.matrix([v for H_i in y for v in (H_i, c_b * mp.mpf(zdot) * H_i)])  # (20)
        e_m = mp.mpf(z_a) - (w.T * u)[0]  # (15)
        pi = P * u  # (23)
        mu = pi / (lam + (u.T * pi)[0])
        w = w + mu * e_m
        P = P / lam - mu * (u.T * P) / lam
        case["z_a"].append(z_a)
        volts.append(float(x))
        errors.append(float(e_m))
        weights.append(doubles(w))
    return case | {"x": volts, "e_m": errors, "w": weights, "P": [doubles(P[i, :]) for i in range(2 * n)]}


def main():
    rng = random.Random(2009)
    shapes = [(1, 1), (2, 2), (4, 3), (8, 3), (8, 1)]
    write("forward", [forward_case(rng, n, m) for n, m in shapes])
    write("inverse", [inverse_case(rng, n, m) for n, m in shapes])
    write("loop", [loop_case(rng, n) for n in (1, 2, 4)])


def write(name, cases):
    rows = ["{" + ",\n ".join(f"{json.dumps(k)}: {json.dumps(v)}" for k, v in case.items()) + "}" for case in cases]
    Path(__file__).with_name(f"{name}.json").write_text("[" + ",\n".join(rows) + "]\n")


if __name__ == "__main__":
    main()
