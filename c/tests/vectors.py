"""Writes vectors.h: the numbered equations in exact fractions, by code that shares nothing with the kernel.

    python3 c/tests/vectors.py > c/tests/vectors.h

Every literal has 21 significant digits, so that it round-trips in double and beyond.
"""

from fractions import Fraction as F
from random import Random

rng = Random(2009)


def decimal(value: F) -> str:
    """21 significant digits, scientific, rounded half up from the exact fraction."""
    if value == 0:
        return "0"
    sign, value, exponent = ("-" if value < 0 else ""), abs(value), 0
    while value >= 10:
        value, exponent = value / 10, exponent + 1
    while value < 1:
        value, exponent = value * 10, exponent - 1
    digits = str(int(value * 10**20 + F(1, 2)))
    return f"{sign}{digits[0]}.{digits[1:]}e{exponent}"


def array(name: str, rows: list) -> None:
    flat = [x for row in rows for x in (row if isinstance(row, list) else [row])]
    print(f"static const double {name}[{len(flat)}] = {{")
    for x in flat:
        print(f"    {decimal(x)},")
    print("};")


def draw(low: int, high: int) -> F:
    return F(rng.randint(low, high), 1024)


n, ticks = 5, 60
r = [F(0)] + sorted(draw(100, 2000) for _ in range(n - 1))
y0 = [F(0)] * n

# (1): the middle one of x - r, the last state, x + r
x, plays = [], []
state = list(y0)
for _ in range(ticks):
    x.append(draw(-2000, 4000))
    state = [sorted((x[-1] - ri, yi, x[-1] + ri))[1] for ri, yi in zip(r, state)]
    plays.append(state)

# (10), (12): the inverse by its own play operators, with new admissible weights at every tick
targets, slopes, volts = [], [], []
state = list(y0)
for _ in range(ticks):
    w = [draw(4000, 9000)] + [draw(-900, 1500) for _ in range(n - 1)]
    s = [sum(w[: i + 1]) for i in range(n)]
    assert min(s) > 0
    w_inv = [1 / w[0]] + [-w[i] / (s[i] * s[i - 1]) for i in range(1, n)]
    r_inv = [sum(w[j] * (r[i] - r[j]) for j in range(i + 1)) for i in range(n)]
    y_inv = [
        sum(w[j] * state[i] for j in range(i + 1)) + sum(w[j] * state[j] for j in range(i + 1, n)) for i in range(n)
    ]
    target = draw(-5000, 30000)
    moved = [sorted((target - ri, yi, target + ri))[1] for ri, yi in zip(r_inv, y_inv)]
    volt = sum(wi * hi for wi, hi in zip(w_inv, moved))
    state = [sorted((volt - ri, yi, volt + ri))[1] for ri, yi in zip(r, state)]
    state = [F(round(v * 2**60), 2**60) for v in state]  # keeps the fractions short: far below rounding in double
    state[0] = F(round(volt * 2**60), 2**60)
    targets.append(target)
    slopes.append(s)
    volts.append(volt)

# (23) with lambda = 63/64
m, updates, lam = 4, 25, F(63, 64)
w_rls, P = [F(5)] + [F(0)] * (m - 1), [[F(1000) if i == j else F(0) for j in range(m)] for i in range(m)]
u_all, e_all, w_all, trace = [], [], [], []
for _ in range(updates):
    u, e = [draw(-2048, 2048) for _ in range(m)], draw(-300, 300)
    pi = [sum(P[i][j] * u[j] for j in range(m)) for i in range(m)]
    mu = [p / (lam + sum(ui * q for ui, q in zip(u, pi))) for p in pi]
    w_rls = [wi + mi * e for wi, mi in zip(w_rls, mu)]
    P = [[(P[i][j] - mu[i] * sum(u[k] * P[k][j] for k in range(m))) / lam for j in range(m)] for i in range(m)]
    u_all.append(u), e_all.append(e), w_all.append(list(w_rls)), trace.append(sum(P[i][i] for i in range(m)))

# (4), (5)
d, w_s = [F(0), F(12), F(20)], [F(1), F(3, 50), F(-1, 25)]
z = [draw(-4000, 32000) for _ in range(20)]
y_s = [w_s[0] * v + sum(w * max(v - t, F(0)) for w, t in zip(w_s[1:], d[1:])) for v in z]

# Kalman filter of weights that return to a prior, every second tick, behind two poles: in the information form, exact
# but for a rounding to 200 bits that keeps the fractions short


def short(x: F) -> F:
    return F(round(x * 2**200), 2**200)


def inverse(A: list) -> list:
    n = len(A)
    rows = [list(row) + [F(i == j) for j in range(n)] for i, row in enumerate(A)]
    for i in range(n):
        pivot = next(k for k in range(i, n) if rows[k][i] != 0)
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [x / rows[i][i] for x in rows[i]]
        for k in range(n):
            if k != i:
                rows[k] = [x - rows[k][i] * y for x, y in zip(rows[k], rows[i])]
    return [row[n:] for row in rows]


k_ticks, alpha, r_kalman, back, share = 60, F(1, 2), F(1, 64), F(1, 32), F(1, 8)
threshold, change_rate, refractory, gain2, hysteresis2 = F(8), F(1, 4), 10, F(1, 16), F(9, 64)
part = [1, 2, 2, 0]
w0_kalman = [F(8), F(2), F(1), F(0)]
P0_kalman = [
    [(F(1, 8) * w0_kalman[i] * w0_kalman[j] if part[i] and part[j] else F(0)) + F(i == j) for j in range(4)]
    for i in range(4)
]
w_k, P_k, P_next = list(w0_kalman), [list(row) for row in P0_kalman], None
level, since, updates_k, fired = F(0), 10**9, 0, False
truth = [F(9), F(1), F(3, 2), F(1, 4)]
k_u, k_y, k_w, k_p, k_changed = [], [], [], [], []
once = twice = []
for k in range(k_ticks):
    u = [draw(-2048, 2048) for _ in range(4)]
    y = sum(a * b for a, b in zip(truth if k < 30 else [F(6), F(2), F(2), F(1, 4)], u)) + draw(-100, 100)
    both = [*u, y]
    once = both if k == 0 else [(1 - alpha) * a + alpha * b for a, b in zip(once, both)]
    twice = both if k == 0 else [(1 - alpha) * a + alpha * b for a, b in zip(twice, once)]
    once, twice = [short(x) for x in once], [short(x) for x in twice]
    since += 1
    if k % 2 == 0:
        uf, yf = twice[:4], twice[4]
        information = inverse(P_k)
        P_next = inverse([[information[i][j] + uf[i] * uf[j] / r_kalman for j in range(4)] for i in range(4)])
        e = yf - sum(a * b for a, b in zip(uf, w_k))
        variance = r_kalman + sum(uf[i] * P_k[i][j] * uf[j] for i in range(4) for j in range(4))
        right = [sum(information[i][j] * w_k[j] for j in range(4)) + uf[i] * yf / r_kalman for i in range(4)]
        w_k = [short(sum(P_next[i][j] * right[j] for j in range(4))) for i in range(4)]
        updates_k += 1
        if updates_k % 8 == 0:
            w_k = [wi + back * (w0i - wi) for wi, w0i in zip(w_k, w0_kalman)]
        level += change_rate * (min(e * e / variance, F(100)) - level)
        fired = level > threshold and since >= refractory
        if fired:
            level, since = F(0), 0
    else:
        leave = (back if updates_k % 8 == 0 else F(0)) + (share if fired else F(0))
        grow = [
            [
                (gain2 if part[i] and part[j] else F(0)) + (hysteresis2 if part[i] == part[j] == 2 else F(0))
                for j in range(4)
            ]
            for i in range(4)
        ]
        P_k = [
            [
                short(
                    (1 - leave) * P_next[i][j]
                    + leave * P0_kalman[i][j]
                    + (grow[i][j] * w_k[i] * w_k[j] if fired else 0)
                )
                for j in range(4)
            ]
            for i in range(4)
        ]
    level = short(level)
    k_u.append(u), k_y.append(y), k_w.append(list(w_k)), k_changed.append(F(fired and k % 2 == 0))
    if k % 2:
        k_p.append([P_k[i][j] for i in range(4) for j in range(i + 1)])
assert 1 <= sum(k_changed) <= 3

print("/* Written by vectors.py: do not edit. */")
print(f"enum {{ K_M = 4, K_TICKS = {k_ticks}, K_REFRACTORY = {refractory} }};")
print(f"enum {{ N = {n}, TICKS = {ticks}, M = {m}, UPDATES = {updates}, DEAD = {len(d)}, POINTS = {len(z)} }};")
print(f"static const double LAMBDA = {decimal(lam)};")
for name, value in (
    ("R", r),
    ("X", x),
    ("PLAYS", plays),
    ("TARGETS", targets),
    ("SLOPES", slopes),
    ("VOLTS", volts),
    ("U", u_all),
    ("E", e_all),
    ("W", w_all),
    ("TRACE", trace),
    ("D", d),
    ("W_S", w_s),
    ("Z", z),
    ("Y_S", y_s),
    ("K_W0", w0_kalman),
    ("K_P0", [P0_kalman[i][j] for i in range(4) for j in range(i + 1)]),
    ("K_U", k_u),
    ("K_Y", k_y),
    ("K_W", k_w),
    ("K_P", k_p),
    ("K_CHANGED", k_changed),
):
    array(name, value)
