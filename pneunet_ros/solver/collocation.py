"""The boundary value problem of the rod by Gauss collocation: one Newton method, one rod or many at once.

The rod is cut into panels, always at a jump of the moment law. On each panel the field equations hold at
four Gauss points (order eight at the panel ends); the linearized panels are eliminated one by one and
joined by an orthonormalized sweep, which stays stable where shooting grows like exp(l sqrt(F/B)). The
turning of the unloaded rod is known in closed form and subtracted, so kinks of its table do no harm.

Layout. `panels[p]` holds the columns named below; `nodes[p] = (theta at the start, theta at the four Gauss
points, moment at the start)` and `nodes[-1] = (theta at the end, 0, 0, 0, 0, moment at the end)`.
"""

from __future__ import annotations

import math

import numpy as np

from pneunet_ros.solver.compiled import inlined, kernel

# Columns of a panel: length h, 1/B, M_O, cubic term, axial compliance, stretch at no force, force n at the
# start and its loss over the panel, turning of the unloaded rod from the start to the Gauss points and the
# end, arclength of the start.
H, COMPLIANCE, OFFSET, CUBIC, AXIAL, STRETCH, N1, N2, Q1, Q2, TURN, TURN_END, START = (
    0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 14, 15,
)  # fmt: skip
PANEL_WIDTH = 16
NODE_WIDTH = 6
GAUSS_POINTS = 4

_points, _weights = np.polynomial.legendre.leggauss(GAUSS_POINTS)
GAUSS_ABSCISSAE = (_points + 1.0) / 2.0
GAUSS_WEIGHTS = _weights / 2.0
_powers = np.arange(1, GAUSS_POINTS + 1)
GAUSS_INTEGRATION = (GAUSS_ABSCISSAE[:, None] ** _powers / _powers) @ np.linalg.inv(
    np.vander(GAUSS_ABSCISSAE, GAUSS_POINTS, increasing=True)
)
C1, C2, C3, C4 = GAUSS_ABSCISSAE.tolist()
W = tuple(GAUSS_WEIGHTS.tolist())
A1, A2, A3, A4 = (tuple(row) for row in GAUSS_INTEGRATION.tolist())
T1, T2, T3, T4 = (tuple(column) for column in GAUSS_INTEGRATION.T.tolist())

SIN = [(-1) ** n / math.factorial(2 * n + 1) for n in range(10)]
COS = [(-1) ** n / math.factorial(2 * n) for n in range(11)]
S0, S1, S2, S3, S4, S5, S6, S7, S8, S9 = SIN
K0, K1, K2, K3, K4, K5, K6, K7, K8, K9, K10 = COS
ONE_OVER_PI = 1.0 / math.pi
PI_HIGH = float.fromhex('0x1.921fb544p+1')
PI_LOW = 1.2154201256553420e-10  # pi - PI_HIGH, to 53 bits more


@inlined
def sine_cosine(x):
    """Sine and cosine to 5e-16, without branches, so that loops over rods vectorize (8 x libm here)."""
    k = math.floor(x * ONE_OVER_PI + 0.5)
    r = (x - k * PI_HIGH) - k * PI_LOW
    z = r * r
    sine = r * (S0 + z * (S1 + z * (S2 + z * (S3 + z * (S4 + z * (
        S5 + z * (S6 + z * (S7 + z * (S8 + z * S9)))))))))  # fmt: skip
    cosine = K0 + z * (K1 + z * (K2 + z * (K3 + z * (K4 + z * (K5 + z * (
        K6 + z * (K7 + z * (K8 + z * (K9 + z * K10)))))))))  # fmt: skip
    sign = 1.0 - 2.0 * (k - 2.0 * math.floor(0.5 * k))
    return sign * sine, sign * cosine


@inlined
def curvature_change(moment, law):
    """Solve M = M_O + B d (1 + c d^2) for d = kappa - kappa0; also d d/d M. law = (1/B, M_O, c)."""
    compliance, offset, cubic = law
    mu = (moment - offset) * compliance
    d = mu
    slope = 1.0
    if cubic > 0.0:
        d = mu / np.cbrt(1.0 + cubic * mu * mu)
        for _ in range(4):  # Halley, cubic convergence from a start within 30 %
            f = d * (1.0 + cubic * d * d) - mu
            g = 1.0 + 3.0 * cubic * d * d
            d -= 2.0 * f * g / (2.0 * g * g - f * 6.0 * cubic * d)
        slope = 1.0 / (1.0 + 3.0 * cubic * d * d)
    return d, slope * compliance


@inlined
def moment_slope(theta, n1, n2, axial, stretch):
    """dM/ds = -lambda (n2 cos - n1 sin), lambda = stretch + axial n.t (Eq 4); also its d/d theta."""
    sine, cosine = sine_cosine(theta)
    t = n1 * cosine + n2 * sine
    u = n2 * cosine - n1 * sine
    stretched = stretch + axial * t
    return -stretched * u, stretched * t - axial * u * u


@inlined
def dot(a, b):
    """Inner product of two 4-tuples."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]


@inlined
def times(a, b):
    """Elementwise product of two 4-tuples."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2], a[3] * b[3]


@inlined
def less(a, f, b):
    """The row a - f b."""
    return a[0] - f * b[0], a[1] - f * b[1], a[2] - f * b[2], a[3] - f * b[3]


@inlined
def less3(a, f, b):
    """The right-hand sides a - f b."""
    return a[0] - f * b[0], a[1] - f * b[1], a[2] - f * b[2]


@inlined
def panel_residual(h, law, mechanics, turn, theta_a, theta, moment_a):
    """How far a panel is from equilibrium (Eq 4 at the Gauss points), and the slopes Newton needs.

    law = (1/B, M_O, cubic), mechanics = (axial compliance, stretch at no force, n1, n2, loss of n1, loss
    of n2), turn = turning of the unloaded rod to the Gauss points and the end. Returns the residual at the
    Gauss points, theta and moment at the end, h dM'/d theta and h d kappa/dM at the Gauss points.
    """
    a, stretch, n1, n2, q1, q2 = mechanics
    g1, k1 = moment_slope(theta[0], n1 - C1 * q1, n2 - C1 * q2, a, stretch)
    g2, k2 = moment_slope(theta[1], n1 - C2 * q1, n2 - C2 * q2, a, stretch)
    g3, k3 = moment_slope(theta[2], n1 - C3 * q1, n2 - C3 * q2, a, stretch)
    g4, k4 = moment_slope(theta[3], n1 - C4 * q1, n2 - C4 * q2, a, stretch)
    g = (h * g1, h * g2, h * g3, h * g4)
    d1, e1 = curvature_change(moment_a + dot(A1, g), law)
    d2, e2 = curvature_change(moment_a + dot(A2, g), law)
    d3, e3 = curvature_change(moment_a + dot(A3, g), law)
    d4, e4 = curvature_change(moment_a + dot(A4, g), law)
    d = (h * d1, h * d2, h * d3, h * d4)
    residual = (
        theta_a + turn[0] + dot(A1, d) - theta[0],
        theta_a + turn[1] + dot(A2, d) - theta[1],
        theta_a + turn[2] + dot(A3, d) - theta[2],
        theta_a + turn[3] + dot(A4, d) - theta[3],
    )
    theta_b = theta_a + turn[4] + dot(W, d)
    moment_b = moment_a + dot(W, g)
    return residual, theta_b, moment_b, (h * k1, h * k2, h * k3, h * k4), (
        h * e1, h * e2, h * e3, h * e4)  # fmt: skip


@inlined
def panel_elimination(r, k, e):
    """Eliminate the Gauss points of a linearized panel, (I - A e A k) d theta = r + y d theta_a + x d M_a.

    Returns per Gauss point the solutions for the right-hand sides (r, 1, A e), and the changes at the end
    of the panel: (c1, f11, f12) of theta and (c2, f21, f22) of the moment. Without pivoting: the mesh
    keeps the matrix near the identity, and the residual of every step is checked.
    """
    b1, b2, b3, b4, b5 = times(A1, e), times(A2, e), times(A3, e), times(A4, e), times(W, e)
    m1 = (1.0 - k[0] * dot(b1, T1), -k[1] * dot(b1, T2), -k[2] * dot(b1, T3), -k[3] * dot(b1, T4))
    m2 = (-k[0] * dot(b2, T1), 1.0 - k[1] * dot(b2, T2), -k[2] * dot(b2, T3), -k[3] * dot(b2, T4))
    m3 = (-k[0] * dot(b3, T1), -k[1] * dot(b3, T2), 1.0 - k[2] * dot(b3, T3), -k[3] * dot(b3, T4))
    m4 = (-k[0] * dot(b4, T1), -k[1] * dot(b4, T2), -k[2] * dot(b4, T3), 1.0 - k[3] * dot(b4, T4))
    v = (k[0] * dot(b5, T1), k[1] * dot(b5, T2), k[2] * dot(b5, T3), k[3] * dot(b5, T4))
    z1 = (r[0], 1.0, b1[0] + b1[1] + b1[2] + b1[3])
    z2 = (r[1], 1.0, b2[0] + b2[1] + b2[2] + b2[3])
    z3 = (r[2], 1.0, b3[0] + b3[1] + b3[2] + b3[3])
    z4 = (r[3], 1.0, b4[0] + b4[1] + b4[2] + b4[3])
    x5 = b5[0] + b5[1] + b5[2] + b5[3]

    p1 = 1.0 / m1[0]
    f2, f3, f4 = m2[0] * p1, m3[0] * p1, m4[0] * p1
    m2, m3, m4 = less(m2, f2, m1), less(m3, f3, m1), less(m4, f4, m1)
    z2, z3, z4 = less3(z2, f2, z1), less3(z3, f3, z1), less3(z4, f4, z1)
    p2 = 1.0 / m2[1]
    f3, f4 = m3[1] * p2, m4[1] * p2
    m3, m4 = less(m3, f3, m2), less(m4, f4, m2)
    z3, z4 = less3(z3, f3, z2), less3(z4, f4, z2)
    p3 = 1.0 / m3[2]
    f4 = m4[2] * p3
    m4, z4 = less(m4, f4, m3), less3(z4, f4, z3)
    p4 = 1.0 / m4[3]

    z4 = (z4[0] * p4, z4[1] * p4, z4[2] * p4)
    z3 = less3(z3, m3[3], z4)
    z3 = (z3[0] * p3, z3[1] * p3, z3[2] * p3)
    z2 = less3(less3(z2, m2[3], z4), m2[2], z3)
    z2 = (z2[0] * p2, z2[1] * p2, z2[2] * p2)
    z1 = less3(less3(less3(z1, m1[3], z4), m1[2], z3), m1[1], z2)
    z1 = (z1[0] * p1, z1[1] * p1, z1[2] * p1)

    wk = times(W, k)
    to_theta = (
        v[0] * z1[0] + v[1] * z2[0] + v[2] * z3[0] + v[3] * z4[0],
        1.0 + v[0] * z1[1] + v[1] * z2[1] + v[2] * z3[1] + v[3] * z4[1],
        x5 + v[0] * z1[2] + v[1] * z2[2] + v[2] * z3[2] + v[3] * z4[2],
    )
    to_moment = (
        wk[0] * z1[0] + wk[1] * z2[0] + wk[2] * z3[0] + wk[3] * z4[0],
        wk[0] * z1[1] + wk[1] * z2[1] + wk[2] * z3[1] + wk[3] * z4[1],
        1.0 + wk[0] * z1[2] + wk[1] * z2[2] + wk[2] * z3[2] + wk[3] * z4[2],
    )
    return z1, z2, z3, z4, to_theta, to_moment


@inlined
def load_panel(panels, p):
    """The columns of one panel as the tuples the equations take."""
    row = panels[p]
    law = (row[1], row[2], row[3])
    mechanics = (row[4], row[5], row[6], row[7], row[8], row[9])
    turn = (row[10], row[11], row[12], row[13], row[14])
    return row[0], law, mechanics, turn


@kernel
def residual_pass(panels, ends, nodes, slopes, moment_scale):
    """Residual of the whole rod, in rad (moments times `moment_scale`); fills `slopes` for the Newton step.

    `ends` = (clamp angle, clamp compliance, load offset, end force F1, F2, end moment).
    """
    count = panels.shape[0]
    worst = abs(nodes[0, 0] - ends[0] - ends[1] * nodes[0, 5])
    sine, cosine = sine_cosine(nodes[count, 0])
    end_moment = ends[5] - ends[2] * (ends[3] * cosine + ends[4] * sine)
    worst = max(worst, abs(nodes[count, 5] - end_moment) * moment_scale)
    for p in range(count):
        h, law, mechanics, turn = load_panel(panels, p)
        node = nodes[p]
        theta = (node[1], node[2], node[3], node[4])
        r, theta_b, moment_b, k, e = panel_residual(
            h, law, mechanics, turn, node[0], theta, node[5]
        )
        r5 = theta_b - nodes[p + 1, 0]
        r6 = moment_b - nodes[p + 1, 5]
        row = slopes[p]
        row[0], row[1], row[2], row[3], row[4], row[5] = r[0], r[1], r[2], r[3], r5, r6
        row[6], row[7], row[8], row[9] = k
        row[10], row[11], row[12], row[13] = e
        worst = max(worst, abs(r[0]), abs(r[1]), abs(r[2]), abs(r[3]), abs(r5))
        worst = max(worst, abs(r6) * moment_scale)
        if not worst < 1e300:
            return np.inf
    return worst


@kernel
def newton_step(ends, nodes, slopes, steps, moment_scale, size):
    """One Newton step, `size` of it taken; `steps` is scratch (panels + 1, 20)."""
    count = slopes.shape[0]
    # state at a joint = w + t v; v spans what the clamp leaves free, kept at unit length (rad, M * scale)
    s = moment_scale
    v0, v1 = ends[1], 1.0
    norm = 1.0 / math.sqrt(v0 * v0 + v1 * v1 * s * s)
    v0 *= norm
    v1 *= norm
    w0, w1 = ends[0] + ends[1] * nodes[0, 5] - nodes[0, 0], 0.0
    for p in range(count):
        row = slopes[p]
        z1, z2, z3, z4, f, g = panel_elimination(
            (row[0], row[1], row[2], row[3]),
            (row[6], row[7], row[8], row[9]),
            (row[10], row[11], row[12], row[13]),
        )
        out = steps[p]
        out[0], out[1], out[2] = z1
        out[3], out[4], out[5] = z2
        out[6], out[7], out[8] = z3
        out[9], out[10], out[11] = z4
        out[12], out[13], out[14], out[15] = v0, v1, w0, w1
        c0, c1 = f[0] + row[4], g[0] + row[5]
        w0, w1 = c0 + f[1] * w0 + f[2] * w1, c1 + g[1] * w0 + g[2] * w1
        v0, v1 = f[1] * v0 + f[2] * v1, g[1] * v0 + g[2] * v1
        growth = math.sqrt(v0 * v0 + v1 * v1 * s * s)
        v0 /= growth
        v1 /= growth
        along = w0 * v0 + w1 * v1 * s * s
        w0 -= along * v0
        w1 -= along * v1
        out[16], out[17] = along, 1.0 / growth
    sine, cosine = sine_cosine(nodes[count, 0])
    end_moment = ends[5] - ends[2] * (ends[3] * cosine + ends[4] * sine)
    end_slope = ends[2] * (ends[4] * cosine - ends[3] * sine)
    t = (end_moment - nodes[count, 5] - w1 - end_slope * w0) / (v1 + end_slope * v0)
    nodes[count, 0] += size * (w0 + t * v0)
    nodes[count, 5] += size * (w1 + t * v1)
    for p in range(count - 1, -1, -1):
        out = steps[p]
        t = (t - out[16]) * out[17]
        d0 = out[14] + t * out[12]
        d1 = out[15] + t * out[13]
        node = nodes[p]
        node[0] += size * d0
        node[5] += size * d1
        node[1] += size * (out[0] + out[1] * d0 + out[2] * d1)
        node[2] += size * (out[3] + out[4] * d0 + out[5] * d1)
        node[3] += size * (out[6] + out[7] * d0 + out[8] * d1)
        node[4] += size * (out[9] + out[10] * d0 + out[11] * d1)
