"""The equations of one panel of the rod (Eq 4) at four Gauss points, and their linearization.

All functions take plain numbers and tuples, without branches in the common case, so that the same
code serves a single rod and a vectorized loop over many rods.
"""

from __future__ import annotations

import math

import numpy as np
from pneunet_ros.core.kernels.jit import inlined

Four = tuple[float, float, float, float]
Triangle = tuple[Four, Four, Four, Four, Four]
Law = tuple[float, float, float]  # 1/B, M_O, cubic term
# Axial compliance, stretch at no force, force n1, n2 at the start of the panel, their loss over
# it.
Mechanics = tuple[float, float, float, float, float, float]
# Intrinsic rotation over the panel to its Gauss points and to its end.
Turn = tuple[float, float, float, float, float]

GAUSS_POINTS = 4
_points, _weights = np.polynomial.legendre.leggauss(GAUSS_POINTS)
GAUSS_ABSCISSAE = (_points + 1.0) / 2.0
GAUSS_WEIGHTS = _weights / 2.0
_powers = np.arange(1, GAUSS_POINTS + 1)
# GAUSS_INTEGRATION[i] integrates from the start of a unit panel to Gauss point i.
GAUSS_INTEGRATION = (GAUSS_ABSCISSAE[:, None] ** _powers / _powers) @ np.linalg.inv(
    np.vander(GAUSS_ABSCISSAE, GAUSS_POINTS, increasing=True)
)
C1, C2, C3, C4 = GAUSS_ABSCISSAE.tolist()
W = tuple(GAUSS_WEIGHTS.tolist())
A1, A2, A3, A4 = (tuple(row) for row in GAUSS_INTEGRATION.tolist())
T1, T2, T3, T4 = (tuple(column) for column in GAUSS_INTEGRATION.T.tolist())

S0, S1, S2, S3, S4, S5, S6, S7, S8, S9 = ((-1) ** n / math.factorial(2 * n + 1) for n in range(10))
K0, K1, K2, K3, K4, K5, K6, K7, K8, K9, K10 = (
    (-1) ** n / math.factorial(2 * n) for n in range(11)
)
ONE_OVER_PI = 1.0 / math.pi
PI_HIGH = float.fromhex('0x1.921fb544p+1')
PI_LOW = 1.2154201256553420e-10  # pi - PI_HIGH, the next 53 bits


@inlined
def sine_cosine(x: float) -> tuple[float, float]:
    """Return sine and cosine by Taylor series on [-pi/2, pi/2], to 5e-16.

    Without branches or tables, so that loops over rods vectorize; 8 times as fast as libm.
    """
    k = np.floor(x * ONE_OVER_PI + 0.5)
    r = (x - k * PI_HIGH) - k * PI_LOW
    z = r * r
    sine = S6 + z * (S7 + z * (S8 + z * S9))
    sine = r * (S0 + z * (S1 + z * (S2 + z * (S3 + z * (S4 + z * (S5 + z * sine))))))
    cosine = K6 + z * (K7 + z * (K8 + z * (K9 + z * K10)))
    cosine = K0 + z * (K1 + z * (K2 + z * (K3 + z * (K4 + z * (K5 + z * cosine)))))
    sign = 1.0 - 2.0 * (k - 2.0 * np.floor(0.5 * k))
    return sign * sine, sign * cosine


@inlined
def curvature_change(moment: float, law: Law) -> tuple[float, float]:
    """Solve M = M_O + B d (1 + c d^2) for d = kappa - kappa0; also d d/d M."""
    compliance, offset, cubic = law
    mu = (moment - offset) * compliance
    d = mu
    slope = 1.0
    if cubic > 0.0:
        d = mu / np.cbrt(1.0 + cubic * mu * mu)
        for _ in range(4):  # Halley's method: cubic convergence from a start within 30 %
            f = d * (1.0 + cubic * d * d) - mu
            g = 1.0 + 3.0 * cubic * d * d
            d -= 2.0 * f * g / (2.0 * g * g - f * 6.0 * cubic * d)
        slope = 1.0 / (1.0 + 3.0 * cubic * d * d)
    return d, slope * compliance


@inlined
def resolve(sine: float, cosine: float, n1: float, n2: float) -> tuple[float, float]:
    """Return axial and transverse force: t = n1 cos + n2 sin, u = n2 cos - n1 sin = dt/d theta."""
    return n1 * cosine + n2 * sine, n2 * cosine - n1 * sine


@inlined
def dot(a: Four, b: Four) -> float:
    """Return the inner product."""
    a1, a2, a3, a4 = a
    b1, b2, b3, b4 = b
    return a1 * b1 + a2 * b2 + a3 * b3 + a4 * b4


@inlined
def total(a: Four) -> float:
    """Return the sum of the entries of a row."""
    a1, a2, a3, a4 = a
    return a1 + a2 + a3 + a4


@inlined
def plus(f: float, a: Four) -> Four:
    """Return the row f + a."""
    a1, a2, a3, a4 = a
    return f + a1, f + a2, f + a3, f + a4


@inlined
def add(a: Four, b: Four) -> Four:
    """Return the elementwise sum."""
    a1, a2, a3, a4 = a
    b1, b2, b3, b4 = b
    return a1 + b1, a2 + b2, a3 + b3, a4 + b4


@inlined
def minus(a: Four, b: Four) -> Four:
    """Return the elementwise difference."""
    a1, a2, a3, a4 = a
    b1, b2, b3, b4 = b
    return a1 - b1, a2 - b2, a3 - b3, a4 - b4


@inlined
def times(a: Four, b: Four) -> Four:
    """Return the elementwise product."""
    a1, a2, a3, a4 = a
    b1, b2, b3, b4 = b
    return a1 * b1, a2 * b2, a3 * b3, a4 * b4


@inlined
def scaled(f: float, a: Four) -> Four:
    """Return the row f a."""
    a1, a2, a3, a4 = a
    return f * a1, f * a2, f * a3, f * a4


@inlined
def gauss_integrals(a: Four) -> Four:
    """Return the integral from the start of a unit panel to its Gauss points."""
    return dot(A1, a), dot(A2, a), dot(A3, a), dot(A4, a)


@inlined
def free_end(load: Four, theta: float) -> tuple[float, float]:
    """Return the moment (N m) of the offset load on the free end, and -d(moment)/d theta.

    load: transverse offset m, F1, F2 N, M N m.
    """
    offset, n1, n2, moment = load
    sine, cosine = sine_cosine(theta)
    return moment - offset * (n1 * cosine + n2 * sine), offset * (n2 * cosine - n1 * sine)


@inlined
def panel_fields(
    h: float, law: Law, mechanics: Mechanics, theta: Four, moment_a: float
) -> tuple[Four, Four, Four, Four, Four, Four, Four, Four]:
    """Return the state at the Gauss points of a panel, from theta there and the first moment.

    Returns sin, cos, axial force t = n.t, transverse force u = n x t, stretch, moment, d = kappa -
    kappa0 and d d/dM. M' = -stretch u.
    """
    a, rest, n1, n2, q1, q2 = mechanics
    theta_1, theta_2, theta_3, theta_4 = theta
    s1, c1 = sine_cosine(theta_1)
    s2, c2 = sine_cosine(theta_2)
    s3, c3 = sine_cosine(theta_3)
    s4, c4 = sine_cosine(theta_4)
    t1, u1 = resolve(s1, c1, n1 - C1 * q1, n2 - C1 * q2)
    t2, u2 = resolve(s2, c2, n1 - C2 * q1, n2 - C2 * q2)
    t3, u3 = resolve(s3, c3, n1 - C3 * q1, n2 - C3 * q2)
    t4, u4 = resolve(s4, c4, n1 - C4 * q1, n2 - C4 * q2)
    t, u = (t1, t2, t3, t4), (u1, u2, u3, u4)
    stretch = plus(rest, scaled(a, t))
    moment = plus(moment_a, gauss_integrals(times(stretch, scaled(-h, u))))
    m1, m2, m3, m4 = moment
    d1, e1 = curvature_change(m1, law)
    d2, e2 = curvature_change(m2, law)
    d3, e3 = curvature_change(m3, law)
    d4, e4 = curvature_change(m4, law)
    return (
        (s1, s2, s3, s4),
        (c1, c2, c3, c4),
        t,
        u,
        stretch,
        moment,
        (d1, d2, d3, d4),
        (e1, e2, e3, e4),
    )


@inlined
def panel_slopes(h: float, axial: float, t: Four, u: Four, stretch: Four) -> Four:
    """Return h dM'/d theta at the Gauss points: d(-stretch u)/d theta = stretch t - axial u^2."""
    g1, g2, g3, g4 = times(stretch, t)
    u1, u2, u3, u4 = u
    return (
        h * (g1 - axial * u1 * u1),
        h * (g2 - axial * u2 * u2),
        h * (g3 - axial * u3 * u3),
        h * (g4 - axial * u4 * u4),
    )


@inlined
def panel_residual(
    h: float,
    law: Law,
    mechanics: Mechanics,
    turn: Turn,
    theta_a: float,
    theta: Four,
    moment_a: float,
) -> tuple[Four, float, float, Four, Four]:
    """Return the residual of a panel (Eq 4 at the Gauss points), and its slopes for Newton.

    Returns the residual at the Gauss points, theta and moment at the end, and at the Gauss points
    h dM'/d theta and h d kappa/dM.
    """
    _, _, t, u, stretch, _, d, e = panel_fields(h, law, mechanics, theta, moment_a)
    axial, _, _, _, _, _ = mechanics
    turn_1, turn_2, turn_3, turn_4, turn_b = turn
    d = scaled(h, d)
    reached = add(plus(theta_a, (turn_1, turn_2, turn_3, turn_4)), gauss_integrals(d))
    residual = minus(reached, theta)
    theta_b = theta_a + turn_b + dot(W, d)
    moment_b = moment_a - h * dot(W, times(stretch, u))
    slopes = panel_slopes(h, axial, t, u, stretch)
    return residual, theta_b, moment_b, slopes, scaled(h, e)


@inlined
def eliminate(m1: Four, m2: Four, m3: Four, m4: Four) -> Triangle:
    """Return LU factors of the 4 x 4 matrix with these rows, multipliers below the diagonal.

    Pivoting is not needed: the mesh keeps the matrix of a panel near the identity, and the
    residual after every step is checked. The fifth row holds the reciprocal pivots.
    """
    m11, m12, m13, m14 = m1
    m21, m22, m23, m24 = m2
    m31, m32, m33, m34 = m3
    m41, m42, m43, m44 = m4
    p1 = 1.0 / m11
    l21, l31, l41 = m21 * p1, m31 * p1, m41 * p1
    m22, m23, m24 = m22 - l21 * m12, m23 - l21 * m13, m24 - l21 * m14
    m32, m33, m34 = m32 - l31 * m12, m33 - l31 * m13, m34 - l31 * m14
    m42, m43, m44 = m42 - l41 * m12, m43 - l41 * m13, m44 - l41 * m14
    p2 = 1.0 / m22
    l32, l42 = m32 * p2, m42 * p2
    m33, m34 = m33 - l32 * m23, m34 - l32 * m24
    m43, m44 = m43 - l42 * m23, m44 - l42 * m24
    p3 = 1.0 / m33
    l43 = m43 * p3
    m44 = m44 - l43 * m34
    return (
        (m11, m12, m13, m14),
        (l21, m22, m23, m24),
        (l31, l32, m33, m34),
        (l41, l42, l43, m44),
        (p1, p2, p3, 1.0 / m44),
    )


@inlined
def substitute(triangle: Triangle, r: Four) -> Four:
    """Solve with the factors of `eliminate`."""
    m1, m2, m3, m4, reciprocals = triangle
    _, u12, u13, u14 = m1
    l21, _, u23, u24 = m2
    l31, l32, _, u34 = m3
    l41, l42, l43, _ = m4
    p1, p2, p3, p4 = reciprocals
    r1, r2, r3, r4 = r
    z2 = r2 - l21 * r1
    z3 = r3 - l31 * r1 - l32 * z2
    z4 = (r4 - l41 * r1 - l42 * z2 - l43 * z3) * p4
    z3 = (z3 - u34 * z4) * p3
    z2 = (z2 - u23 * z3 - u24 * z4) * p2
    z1 = (r1 - u12 * z2 - u13 * z3 - u14 * z4) * p1
    return z1, z2, z3, z4


@inlined
def linear_panel(k: Four, e: Four) -> tuple[Triangle, Four, Triangle, float]:
    """Linearize a panel: (I - E k) d theta = r + d theta_a + x d M_a with E = A e A.

    Returns the factors of its matrix; x; E with a fifth row for the end of the panel, where
    d theta_b = r + d theta_a + (E_5 k) . d theta + b d M_a and d M_b = r + d M_a + (W k) . d
    theta; and b.
    """
    b1, b2, b3, b4, b5 = times(A1, e), times(A2, e), times(A3, e), times(A4, e), times(W, e)
    e1 = (dot(b1, T1), dot(b1, T2), dot(b1, T3), dot(b1, T4))
    e2 = (dot(b2, T1), dot(b2, T2), dot(b2, T3), dot(b2, T4))
    e3 = (dot(b3, T1), dot(b3, T2), dot(b3, T3), dot(b3, T4))
    e4 = (dot(b4, T1), dot(b4, T2), dot(b4, T3), dot(b4, T4))
    e5 = (dot(b5, T1), dot(b5, T2), dot(b5, T3), dot(b5, T4))
    k1, k2, k3, k4 = k
    e11, e12, e13, e14 = e1
    e21, e22, e23, e24 = e2
    e31, e32, e33, e34 = e3
    e41, e42, e43, e44 = e4
    triangle = eliminate(
        (1.0 - e11 * k1, -e12 * k2, -e13 * k3, -e14 * k4),
        (-e21 * k1, 1.0 - e22 * k2, -e23 * k3, -e24 * k4),
        (-e31 * k1, -e32 * k2, 1.0 - e33 * k3, -e34 * k4),
        (-e41 * k1, -e42 * k2, -e43 * k3, 1.0 - e44 * k4),
    )
    return triangle, (total(b1), total(b2), total(b3), total(b4)), (e1, e2, e3, e4, e5), total(b5)
