"""The equations of one panel of the rod (Eq 4) at four Gauss points, and their linearization.

Everything here works on plain numbers and tuples, without branches in the common case, so that the
same code serves one rod and a loop over many rods that the compiler turns into vector
instructions.
"""

from __future__ import annotations

import math

import numpy as np
from pneunet_ros.core.jit import inlined

Four = tuple[float, float, float, float]
Triangle = tuple[Four, Four, Four, Four, Four]
Law = tuple[float, float, float]  # 1/B, M_O, cubic term
# Axial compliance, stretch at no force, force n1, n2 at the start of the panel, their loss over
# it.
Mechanics = tuple[float, float, float, float, float, float]
Turn = tuple[
    float, float, float, float, float
]  # of the unloaded rod to the Gauss points and the end

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
PI_LOW = 1.2154201256553420e-10  # pi - PI_HIGH, 53 bits further


@inlined
def sine_cosine(x: float) -> tuple[float, float]:
    """Sine and cosine by Taylor's series on [-pi/2, pi/2], to 5e-16.

    Without branches or table, so that loops over rods vectorize; 8 times the speed of libm here.
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
    """Axial and transverse force: t = n1 cos + n2 sin, u = n2 cos - n1 sin = dt/d theta."""
    return n1 * cosine + n2 * sine, n2 * cosine - n1 * sine


@inlined
def dot(a: Four, b: Four) -> float:
    """Inner product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]


@inlined
def times(a: Four, b: Four) -> Four:
    """Elementwise product."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2], a[3] * b[3]


@inlined
def scaled(f: float, a: Four) -> Four:
    """Return the row f a."""
    return f * a[0], f * a[1], f * a[2], f * a[3]


@inlined
def less(a: Four, f: float, b: Four) -> Four:
    """Return the row a - f b."""
    return a[0] - f * b[0], a[1] - f * b[1], a[2] - f * b[2], a[3] - f * b[3]


@inlined
def panel_fields(
    h: float, law: Law, mechanics: Mechanics, theta: Four, moment_a: float
) -> tuple[Four, Four, Four, Four, Four, Four, Four, Four]:
    """Return the rod at the Gauss points of a panel, from theta there and the first moment.

    Returns sin, cos, axial force t = n.t, transverse force u = n x t, stretch, moment, d = kappa -
    kappa0 and d d/dM. M' = -stretch u.
    """
    a, stretch, n1, n2, q1, q2 = mechanics
    s1, c1 = sine_cosine(theta[0])
    s2, c2 = sine_cosine(theta[1])
    s3, c3 = sine_cosine(theta[2])
    s4, c4 = sine_cosine(theta[3])
    t1, u1 = resolve(s1, c1, n1 - C1 * q1, n2 - C1 * q2)
    t2, u2 = resolve(s2, c2, n1 - C2 * q1, n2 - C2 * q2)
    t3, u3 = resolve(s3, c3, n1 - C3 * q1, n2 - C3 * q2)
    t4, u4 = resolve(s4, c4, n1 - C4 * q1, n2 - C4 * q2)
    stretched = (stretch + a * t1, stretch + a * t2, stretch + a * t3, stretch + a * t4)
    g = times(stretched, (-h * u1, -h * u2, -h * u3, -h * u4))
    moment = (
        moment_a + dot(A1, g),
        moment_a + dot(A2, g),
        moment_a + dot(A3, g),
        moment_a + dot(A4, g),
    )
    d1, e1 = curvature_change(moment[0], law)
    d2, e2 = curvature_change(moment[1], law)
    d3, e3 = curvature_change(moment[2], law)
    d4, e4 = curvature_change(moment[3], law)
    return (
        (s1, s2, s3, s4),
        (c1, c2, c3, c4),
        (t1, t2, t3, t4),
        (u1, u2, u3, u4),
        stretched,
        moment,
        (d1, d2, d3, d4),
        (e1, e2, e3, e4),
    )


@inlined
def panel_slopes(h: float, axial: float, t: Four, u: Four, stretched: Four) -> Four:
    """Slopes h dM'/d theta at the Gauss points: d(-stretch u)/d theta = stretch t - axial u^2."""
    return (
        h * (stretched[0] * t[0] - axial * u[0] * u[0]),
        h * (stretched[1] * t[1] - axial * u[1] * u[1]),
        h * (stretched[2] * t[2] - axial * u[2] * u[2]),
        h * (stretched[3] * t[3] - axial * u[3] * u[3]),
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
    """How far a panel is from equilibrium (Eq 4 at the Gauss points), and the slopes Newton needs.

    Returns the residual at the Gauss points, theta and moment at the end, and at the Gauss points
    h dM'/d theta and h d kappa/dM.
    """
    _, _, t, u, stretched, _, d, e = panel_fields(h, law, mechanics, theta, moment_a)
    d = scaled(h, d)
    residual = (
        theta_a + turn[0] + dot(A1, d) - theta[0],
        theta_a + turn[1] + dot(A2, d) - theta[1],
        theta_a + turn[2] + dot(A3, d) - theta[2],
        theta_a + turn[3] + dot(A4, d) - theta[3],
    )
    theta_b = theta_a + turn[4] + dot(W, d)
    moment_b = moment_a - h * dot(W, times(stretched, u))
    slopes = panel_slopes(h, mechanics[0], t, u, stretched)
    return residual, theta_b, moment_b, slopes, scaled(h, e)


@inlined
def eliminate(m1: Four, m2: Four, m3: Four, m4: Four) -> Triangle:
    """Triangular factors of the 4 x 4 matrix with these rows, multipliers below the diagonal.

    Without pivoting: the mesh keeps the matrix of a panel near the identity, and the residual
    after every step is checked. The fifth row holds the reciprocal pivots.
    """
    p1 = 1.0 / m1[0]
    f2, f3, f4 = m2[0] * p1, m3[0] * p1, m4[0] * p1
    m2, m3, m4 = less(m2, f2, m1), less(m3, f3, m1), less(m4, f4, m1)
    p2 = 1.0 / m2[1]
    h3, h4 = m3[1] * p2, m4[1] * p2
    m3, m4 = less(m3, h3, m2), less(m4, h4, m2)
    p3 = 1.0 / m3[2]
    j4 = m4[2] * p3
    m4 = less(m4, j4, m3)
    p4 = 1.0 / m4[3]
    return (
        m1,
        (f2, m2[1], m2[2], m2[3]),
        (f3, h3, m3[2], m3[3]),
        (f4, h4, j4, m4[3]),
        (p1, p2, p3, p4),
    )


@inlined
def substitute(triangle: Triangle, r: Four) -> Four:
    """Solve with the factors of `eliminate`."""
    m1, m2, m3, m4, p = triangle
    z2 = r[1] - m2[0] * r[0]
    z3 = r[2] - m3[0] * r[0] - m3[1] * z2
    z4 = (r[3] - m4[0] * r[0] - m4[1] * z2 - m4[2] * z3) * p[3]
    z3 = (z3 - m3[3] * z4) * p[2]
    z2 = (z2 - m2[2] * z3 - m2[3] * z4) * p[1]
    z1 = (r[0] - m1[1] * z2 - m1[2] * z3 - m1[3] * z4) * p[0]
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
    triangle = eliminate(
        (1.0 - e1[0] * k[0], -e1[1] * k[1], -e1[2] * k[2], -e1[3] * k[3]),
        (-e2[0] * k[0], 1.0 - e2[1] * k[1], -e2[2] * k[2], -e2[3] * k[3]),
        (-e3[0] * k[0], -e3[1] * k[1], 1.0 - e3[2] * k[2], -e3[3] * k[3]),
        (-e4[0] * k[0], -e4[1] * k[1], -e4[2] * k[2], 1.0 - e4[3] * k[3]),
    )
    x = (
        b1[0] + b1[1] + b1[2] + b1[3],
        b2[0] + b2[1] + b2[2] + b2[3],
        b3[0] + b3[1] + b3[2] + b3[3],
        b4[0] + b4[1] + b4[2] + b4[3],
    )
    return triangle, x, (e1, e2, e3, e4, e5), b5[0] + b5[1] + b5[2] + b5[3]
