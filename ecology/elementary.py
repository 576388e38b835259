"""Elementary functions that give the same bits on every processor, within about one unit in the last place.

NumPy and the C library choose among several implementations by what the processor can do, which differ in the last
bit; from there a whole run differs. These are the reductions and polynomials of fdlibm (Sun Microsystems, 1993) in
additions, multiplications and divisions that are rounded one by one. They are meant for finite arguments of ordinary
size: angles up to a million, exponents between -700 and 700. A larger angle is first reduced by whole turns.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from ecology.compiler_cache import compiled, use_cache

use_cache(__file__)

PI, HALF_PI = math.pi, math.pi / 2
TURNS = 1e6  # radians, beyond which an angle is reduced first
HALF_PI_HIGH, HALF_PI_LOW = 1.57079632673412561417e00, 6.07710050650619224932e-11  # 33 bits, and the rest
LN2_HIGH, LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
S1, S2, S3 = -1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04
S4, S5, S6 = 2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10
C1, C2, C3 = 4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05
C4, C5, C6 = -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11
A0, A1, A2 = 3.33333333333329318027e-01, -1.99999999998764832476e-01, 1.42857142725034663711e-01
A3, A4, A5 = -1.11111104054623557880e-01, 9.09088713343650656196e-02, -7.69187620504482999495e-02
A6, A7, A8 = 6.66107313738753120669e-02, -5.83357013379057348645e-02, 4.97687799461593236017e-02
A9, A10 = -3.65315727442169155270e-02, 1.62858201153657823623e-02
E1, E2, E3 = 1.66666666666666019037e-01, -2.77777777770155933842e-03, 6.61375632143793436117e-05
E4, E5 = -1.65339022054652515390e-06, 4.13813679705723846039e-08
L1, L2, L3, L4 = 6.666666666666735130e-01, 3.999999999940941908e-01, 2.857142874366239149e-01, 2.222219843214978396e-01
L5, L6, L7 = 1.818357216161805012e-01, 1.531383769920937332e-01, 1.479819860511658591e-01
COARSE = (4.63647609000806093515e-01, 7.85398163397448278999e-01, 9.82793723247329054082e-01, 1.57079632679489655800e00)
FINE = (2.26987774529616870924e-17, 3.06161699786838301793e-17, 1.39033110312309984516e-17, 6.12323399573676603587e-17)


@compiled
def cosine_and_sine(x: float) -> tuple[float, float]:
    """Return the cosine and the sine of an angle in radians."""
    if abs(x) > TURNS:
        x = np.fmod(x, 2.0 * PI)  # which is exact
    quarter = math.floor(x * (2.0 / PI) + 0.5)
    r = (x - quarter * HALF_PI_HIGH) - quarter * HALF_PI_LOW
    z = r * r
    s = r + r * z * (S1 + z * (S2 + z * (S3 + z * (S4 + z * (S5 + z * S6)))))
    half = 0.5 * z
    whole = 1.0 - half
    c = whole + (((1.0 - whole) - half) + z * z * (C1 + z * (C2 + z * (C3 + z * (C4 + z * (C5 + z * C6))))))
    turns = int(quarter) % 4
    if turns == 1:
        return -s, c
    if turns == 2:
        return -c, -s
    if turns == 3:
        return s, -c
    return c, s


@compiled
def arctangent(x: float) -> float:
    """Return the angle in [0, pi / 2] whose tangent is x >= 0."""
    part = -1
    if x >= 2.4375:
        part, x = 3, -1.0 / x
    elif x >= 1.1875:
        part, x = 2, (x - 1.5) / (1.0 + 1.5 * x)
    elif x >= 0.6875:
        part, x = 1, (x - 1.0) / (x + 1.0)
    elif x >= 0.4375:
        part, x = 0, (2.0 * x - 1.0) / (2.0 + x)
    z = x * x
    w = z * z
    odd = z * (A0 + w * (A2 + w * (A4 + w * (A6 + w * (A8 + w * A10)))))
    even = w * (A1 + w * (A3 + w * (A5 + w * (A7 + w * A9))))
    if part < 0:
        return x - x * (odd + even)
    return COARSE[part] - ((x * (odd + even) - FINE[part]) - x)


@compiled
def angle_of(y: float, x: float) -> float:
    """Return the angle of the vector (x, y) in [-pi, pi], 0 of none."""
    if x == 0.0:
        angle = HALF_PI if y != 0.0 else (0.0 if math.copysign(1.0, x) > 0 else PI)
    else:
        ratio = abs(y) / abs(x)
        angle = HALF_PI if math.isinf(ratio) else arctangent(ratio)
        if x < 0.0:
            angle = PI - angle
    return math.copysign(angle, y)


@compiled
def exponential(x: float) -> float:
    """Return e^x, 0 below -708 and infinity above 709."""
    if x < -708.0:
        return 0.0
    if x > 709.0:
        return np.inf
    power = math.floor(x * (1.0 / math.log(2.0)) + 0.5)
    high, low = x - power * LN2_HIGH, power * LN2_LOW
    r = high - low
    t = r * r
    c = r - t * (E1 + t * (E2 + t * (E3 + t * (E4 + t * E5))))
    y = 1.0 - ((low - (r * c) / (2.0 - c)) - high)
    return math.ldexp(y, int(power))


@compiled
def logarithm(x: float) -> float:
    """Return ln x of x > 0."""
    m, k = math.frexp(x)
    if m < math.sqrt(0.5):
        m, k = 2.0 * m, k - 1
    f = m - 1.0
    s = f / (2.0 + f)
    z = s * s
    r = z * (L1 + z * (L2 + z * (L3 + z * (L4 + z * (L5 + z * (L6 + z * L7))))))
    half = 0.5 * f * f
    return k * LN2_HIGH - ((half - (s * (half + r) + k * LN2_LOW)) - f)


@compiled
def exponential_less_one(x: float) -> float:
    """Return e^x - 1, without loss for a small x (Kahan)."""
    if abs(x) < 1e-300:
        return x
    u = exponential(x)
    if u == 1.0:
        return x
    if u == 0.0 or u == np.inf:
        return u - 1.0
    return (u - 1.0) * (x / logarithm(u))


# ---- the same of arrays ------------------------------------------------------------------------


@numba.vectorize(cache=True)
def cos(x):  # type: ignore[no-untyped-def]
    """Return the cosine of angles in radians."""
    return cosine_and_sine(x)[0]


@numba.vectorize(cache=True)
def sin(x):  # type: ignore[no-untyped-def]
    """Return the sine of angles in radians."""
    return cosine_and_sine(x)[1]


@numba.vectorize(cache=True)
def arctan2(y, x):  # type: ignore[no-untyped-def]
    """Return the angles of vectors (x, y)."""
    return angle_of(y, x)


@numba.vectorize(cache=True)
def exp(x):  # type: ignore[no-untyped-def]
    """Return e^x."""
    return exponential(x)


@numba.vectorize(cache=True)
def log(x):  # type: ignore[no-untyped-def]
    """Return ln x of x > 0."""
    return logarithm(x)


@numba.vectorize(cache=True)
def expm1(x):  # type: ignore[no-untyped-def]
    """Return e^x - 1, without loss for a small x."""
    return exponential_less_one(x)


@numba.vectorize(cache=True)
def power(x, exponent):  # type: ignore[no-untyped-def]
    """Return x^exponent of x >= 0."""
    if exponent == 1.0:
        return x
    if exponent == 0.5:
        return math.sqrt(x)
    if exponent == 0.0:
        return 1.0
    if x == 0.0:
        return 0.0 if exponent > 0.0 else np.inf
    return exponential(exponent * logarithm(x))


def hypot(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the lengths of vectors (x, y)."""
    return np.sqrt(x * x + y * y)
