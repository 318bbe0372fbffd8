"""Peaks, crossings and margins of lightly damped loops, against norms and margins that are computed in other ways."""

import control
import numpy as np
import pytest
from scipy.linalg import LinAlgError, block_diag, eigvals, expm, matrix_balance
from scipy.optimize import brentq

from workbench.robustness.frequency import Closed, System, delay_margin, disk_margin, first_reaching, peak


def drawn(random, *, dt, inputs, outputs, damping=(-4.0, 0.0)) -> System:
    """Some modes of any damping between 10^damping, in coordinates and units that suit nobody; sampled with dt, or dt = 0."""
    count = int(random.integers(1, 4))
    parts = []
    for zeta, omega in zip(10.0 ** random.uniform(*damping, count), 10.0 ** random.uniform(-1.0, 1.0, count), strict=True):
        real, imag = -zeta * omega, omega * np.sqrt(max(0.0, 1.0 - zeta**2))
        parts.append(np.array([[real, imag], [-imag, real]]))
    if random.random() < 0.5:
        parts.append(np.array([[-(10.0 ** random.uniform(-2.0, 1.0))]]))
    A = block_diag(*parts)
    A = expm(A * dt) if dt else A
    n = len(A)
    into = random.normal(size=(n, n)) * 10.0 ** random.uniform(-4.0, 4.0, n)[:, None]
    A, back = into @ A @ np.linalg.inv(into), np.linalg.inv(into)
    B, C = into @ random.normal(size=(n, inputs)), random.normal(size=(outputs, n)) @ back
    D = random.normal(size=(outputs, inputs)) * random.integers(0, 2)
    return System(A, B, C, D, dt)


def normed(system: System) -> float:
    """The norm by bisection: gamma lies above it where the pencil of gamma^2 I - G~G has no eigenvalue on the circle (axis).

    The pencil of Boyd and Balakrishnan as it stands, in z itself, without an inverse and without a frequency.
    """
    A, (size, _) = matrix_balance(system.A, permute=False, separate=True)
    B, C, D = system.B / size[:, None], system.C * size, system.D
    unit = np.sqrt(np.linalg.norm(B) / np.linalg.norm(C))
    B, C = B / unit, C * unit
    n, m = len(A), D.shape[1]
    one, square, tall = np.eye(n), np.zeros((n, n)), np.zeros((n, m))

    def beyond(gamma):
        last = np.hstack([D.T @ C, B.T, D.T @ D - gamma**2 * np.eye(m)]) / gamma
        if system.dt:  # z x = A x + B w, q = z A'q + z C'(C x + D w)
            M = np.vstack([np.hstack([A, square, B]), np.hstack([square, one, tall]), last])
            N = np.vstack([np.hstack([one, square, tall]), np.hstack([C.T @ C, A.T, C.T @ D]), np.zeros_like(last)])
        else:  # s x = A x + B w, s q = -A'q - C'(C x + D w)
            M = np.vstack([np.hstack([A, square, B]), np.hstack([-C.T @ C, -A.T, -C.T @ D]), last])
            N = block_diag(one, one, np.zeros((m, m)))
        try:
            found = eigvals(M, N)
        except LinAlgError:  # QZ does not converge on every pencil; the next one is as good
            return beyond(gamma * (1.0 + 1e-7))
        found = found[np.isfinite(found)]
        off = np.abs(np.abs(found) - 1.0) if system.dt else np.abs(found.real) / np.abs(found)
        return not (off < 1e-9).any()

    low, high = 0.0, 1.0
    while not beyond(high):
        high *= 4.0
    while high - low > 1e-6 * high:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if beyond(middle) else (middle, high)
    return high


def dense(system: System) -> float:
    """The largest gain on fine grids across every pole, from the definition."""
    A, n = system.A, len(system.A)
    poles = np.linalg.eigvals(A).astype(complex)
    s = np.log(poles) / system.dt if system.dt else poles
    low, high = system.ends
    omega = [np.geomspace(low, high, 400)]
    omega += [np.abs(each.imag) + np.abs(each.real) * np.tan(np.linspace(-1.5, 1.5, 801)) for each in s]
    omega = np.concatenate(omega)
    omega = omega[(omega >= low) & (omega <= high)]
    z = np.exp(1j * omega * system.dt) if system.dt else 1j * omega
    into = np.linalg.eig(A)[1]
    modes = (system.C @ into)[None] / (z[:, None, None] - np.linalg.eigvals(A)) @ np.linalg.solve(into, system.B)
    assert len(poles) == n
    return float(np.linalg.norm(modes + system.D, 2, axis=(1, 2)).max())


def of(seed):
    """A system with modest resonances, and one of any damping."""
    random = np.random.default_rng(seed)
    dt = 0.0 if seed % 3 == 0 else float(10.0 ** random.uniform(-1.5, -0.5))
    inputs, outputs = (1, 1) if seed % 2 else random.integers(1, 4, 2).tolist()
    shape = {"dt": dt, "inputs": inputs, "outputs": outputs}
    return drawn(random, **shape, damping=(-2.5, 0.0)), drawn(random, **shape)


def is_the_largest(system):
    """What is found is the gain at its frequency, and no other frequency has more."""
    found = peak(system)
    assert dense(system) * (1.0 - 2e-5) <= found.gain <= dense(system) * (1.0 + 1e-3)
    assert system.gain(np.array([found.omega]))[0] == pytest.approx(found.gain, rel=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_the_peak_is_the_norm(seed):
    calm, any_ = of(seed)
    assert peak(calm).gain == pytest.approx(normed(calm), rel=1e-4)  # elsewhere rounding moves eigenvalues off the circle
    is_the_largest(any_)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100, 300))
def test_the_peak_of_many_is_the_norm(seed):
    for system in of(seed):
        is_the_largest(system)


@pytest.mark.parametrize("zeta", [0.5, 1e-2, 1e-5, 1e-8])
def test_the_peak_of_one_resonance_is_that_of_the_formula(zeta):
    """1 / (s^2 + 2 zeta s + 1): 1 / (2 zeta sqrt(1 - zeta^2)) at sqrt(1 - 2 zeta^2)."""
    system = System([[0.0, 1.0], [-1.0, -2.0 * zeta]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]], 0.0)
    found = peak(system)
    assert found.gain == pytest.approx(1.0 / (2.0 * zeta * np.sqrt(1.0 - zeta**2)), rel=1e-6)
    assert found.omega == pytest.approx(np.sqrt(1.0 - 2.0 * zeta**2), rel=1e-3)


def test_gains_without_resonance_peak_at_the_ends():
    low = System([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.1)
    assert peak(low).gain == pytest.approx(2.0, rel=1e-7)
    assert peak(System([[-0.5]], [[1.0]], [[1.0]], [[0.0]], 0.1)).gain == pytest.approx(2.0, rel=1e-7)
    assert peak(System(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[3.0]], 0.1)).gain == pytest.approx(3.0)
    assert peak(low, least=5.0).gain <= 2.0


def first_order(pole, gain, direct, dt):
    """direct + gain / (z - pole), or over s where dt = 0."""
    return System([[pole]], [[1.0]], [[gain]], [[direct]], dt)


@pytest.mark.parametrize("dt", [0.0, 0.05, 2.0])
def test_a_level_is_reached_where_the_formula_says(dt):
    """s / (s + a) has the gain 1 / sqrt(2) at a; (z - 1) / (z - p) where |z - 1|^2 = |z - p|^2 / 2."""
    p = 0.9
    high_pass = first_order(p, p - 1.0, 1.0, dt) if dt else first_order(-0.3, -0.3, 1.0, dt)
    expected = np.arccos((1.5 - 0.5 * p**2) / (2.0 - p)) / dt if dt else 0.3
    assert first_reaching(high_pass, np.sqrt(0.5)) == pytest.approx(expected, rel=1e-9)
    assert first_reaching(high_pass, 3.0) == high_pass.ends[1]  # nowhere
    low_pass = first_order(p, 1.0 - p, 0.0, dt) if dt else first_order(-0.3, 0.3, 0.0, dt)
    assert first_reaching(low_pass, 0.5) == 0.0  # at once


def test_an_integral_whose_pole_is_rounded_is_no_slow_pole():
    for dt in (0.01, 1.0, 100.0):
        poles = np.diag([0.5, 1.0 - 1e-12]), np.diag([0.5, 1.0 - 1e-6])
        rounded, slow = (System(A, np.ones((2, 1)), np.ones((1, 2)), [[0.0]], dt).ends for A in poles)
        assert rounded == pytest.approx(first_order(0.5, 1.0, 0.0, dt).ends, rel=1e-12)
        assert slow[0] < 1e-5 * rounded[0]


# ---- margins of loops -----------------------------------------------------------------------------------------------------


def loop(random) -> tuple[System, System]:
    """A sampled machine with a lightly damped mode, and a law with an integral that keeps it stable."""
    dt = 0.1
    while True:
        plant = drawn(random, dt=dt, inputs=1, outputs=1, damping=(-3.0, -0.5))
        plant = System(plant.A, plant.B, plant.C, [[0.0]], dt)
        steady = float((plant.C @ np.linalg.solve(np.eye(len(plant.A)) - plant.A, plant.B))[0, 0])
        P, integral = random.uniform(0.0, 0.8) / peak(plant).gain, random.uniform(0.05, 0.5) / steady * random.uniform(0.0, 1.0)
        law = System([[1.0]], [[integral * dt]], [[1.0]], [[P * np.sign(steady)]], dt)
        if Closed.of(plant, law).system.stable:
            return plant, law


def ss(system: System):
    return control.ss(system.A, system.B, system.C, system.D, system.dt)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_margins_of_a_loop_are_those_of_python_control(seed):
    """On a grid that is fine across every pole, with its own interconnection; and one more sample of delay at a time."""
    plant, law = loop(np.random.default_rng(seed))
    closed = Closed.of(plant, law)
    S, dt = closed.input_sensitivity, plant.dt
    L = ss(law) * ss(plant)
    omega = np.unique(np.concatenate([np.geomspace(1e-5, np.pi / dt, 4000), S.around(np.tan(np.linspace(-1.55, 1.55, 2001)))]))
    own = L(np.exp(1j * omega * dt))
    for system, expected in ((S, 1 / (1 + own)), (S.less(1.0), own / (1 + own)), (closed.output_sensitivity, 1 / (1 + own))):
        assert peak(system).gain == pytest.approx(np.abs(expected).max(), rel=1e-4)
    assert peak(closed.effort).gain == pytest.approx(np.abs(ss(law)(np.exp(1j * omega * dt)) / (1 + own)).max(), rel=1e-4)
    assert disk_margin(S) == pytest.approx(control.disk_margins(L, omega)[0], rel=1e-4)
    size = np.abs(1 / (1 + own))
    first = int(np.argmax(size > np.sqrt(0.5)))
    reached = first_reaching(S, np.sqrt(0.5))
    if first == 0:
        assert reached == 0.0
    else:
        exact = brentq(lambda w: abs(1 / (1 + L(np.exp(1j * w * dt)))) - np.sqrt(0.5), omega[first - 1], omega[first])
        assert reached == pytest.approx(exact, rel=1e-6)
    samples = delay_margin(S) / dt
    for n in (1, 2, 5, 20, int(min(samples, 60.0))):
        if n < samples:
            assert later(plant, law, n) < 1.0
    if samples < 60.0:
        assert later(plant, law, int(np.ceil(samples))) >= 1.0 - 1e-9


def later(plant: System, law: System, n: int) -> float:
    """Largest modulus of a pole of the loop with n more samples between law and plant."""
    shift = control.ss(np.eye(n, k=-1), np.eye(n, 1), np.eye(1, n, n - 1), 0.0, plant.dt) if n else 1.0
    return float(np.abs(control.feedback(ss(plant) * shift * ss(law), 1).poles()).max())


def test_a_delay_margin_has_both_its_ends():
    """0.5 / z never crosses: as late as you like. A gain of 2 at all frequencies is lost with the first sample: not at all."""
    law = System(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[1.0]], 0.1)
    late, direct = System([[0.0]], [[1.0]], [[0.5]], [[0.0]], 0.1), System([[0.0]], [[1.0]], [[0.1]], [[2.0]], 0.1)
    assert delay_margin(Closed.of(late, law).input_sensitivity) == np.inf
    assert delay_margin(Closed.of(direct, law).input_sensitivity) == 0.0


@pytest.mark.parametrize(
    ("pole", "gain", "direct"), [(0.5, 0.8, 0.0), (0.9, 0.5, 0.0), (0.0, 0.9, 0.3), (0.4, 0.9, -0.2), (0.0, -0.9, 0.3)]
)
def test_a_delay_margin_is_that_of_the_formula(pole, gain, direct):
    """L = d + g / (z - p): where |L| = 1, |d z + g - d p|^2 = |z - p|^2, which holds the angle of z by its cosine alone."""
    rest = gain - direct * pole
    cosine = (1.0 + pole**2 - direct**2 - rest**2) / (2.0 * (direct * rest + pole))
    z = np.exp(1j * np.arccos(cosine))
    L = direct + gain / (z - pole)
    assert abs(L) == pytest.approx(1.0)
    law = System(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[1.0]], 0.1)
    closed = Closed.of(first_order(pole, gain, direct, 0.1), law)
    assert closed.system.stable
    expected = (np.angle(L) + np.pi) % (2.0 * np.pi) / np.arccos(cosine) * 0.1
    large_above = abs(direct + gain / (-1.0 - pole)) >= 1.0  # then any delay is too much
    assert delay_margin(closed.input_sensitivity) == pytest.approx(0.0 if large_above else expected, rel=1e-7)


@pytest.mark.parametrize("gain", [1e-3, 1e-5, 3e-7])
def test_every_crossing_of_a_resonance_counts_for_the_delay_margin(gain):
    """L = g / ((z - p) (z - p')), p = r exp(j a) near the circle: at the angle a + d, z - p is (1 - r + j d) exp(j a).

    z - p' is 2 j sin a there, so |L| is above 1 from d = -reach to reach; the second crossing is the one that bears less delay.
    """
    a, fade, dt = 0.6, 0.65 * gain, 0.2
    r = 1.0 - fade
    plant = System([[2.0 * r * np.cos(a), -(r**2)], [1.0, 0.0]], [[1.0], [0.0]], [[0.0, gain]], [[0.0]], dt)
    law = System(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[1.0]], dt)
    reach = np.sqrt((0.5 * gain / np.sin(a)) ** 2 - fade**2)
    late = [(np.pi - 0.5 * np.pi - a - np.arctan2(d, fade)) % (2.0 * np.pi) / a * dt for d in (-reach, reach)]
    assert late[1] < 0.2 * late[0]
    assert delay_margin(Closed.of(plant, law).input_sensitivity) == pytest.approx(late[1], rel=5e-3)


def test_disk_margins_of_two_commands_that_do_not_meet_are_the_smaller():
    random = np.random.default_rng(1)
    (one, first), (other, second) = loop(random), loop(random)

    def both(a, b):
        return System(*(block_diag(getattr(a, key), getattr(b, key)) for key in "ABCD"), a.dt)

    alone = [disk_margin(Closed.of(*pair).input_sensitivity) for pair in ((one, first), (other, second))]
    S = Closed.of(both(one, other), both(first, second)).input_sensitivity
    assert disk_margin(S) == pytest.approx(min(alone), rel=1e-6)
    assert disk_margin(S, most=0.5 * min(alone)) >= min(alone) * (1.0 - 1e-6)
    a = alone[0]  # at the edge of the disk the loop is lost: a gain of (2 + a) / (2 - a), or a phase
    gains = np.linspace((2 - a) / (2 + a), (2 + a) / (2 - a), 50)
    assert all(np.abs(control.feedback(g * ss(first) * ss(one), 1).poles()).max() < 1.0 for g in gains)


def test_a_closed_loop_has_both_sensitivities():
    """Two commands, three measurements, direct paths on both sides: from the definitions."""
    random = np.random.default_rng(4)
    plant, law = (drawn(random, dt=0.2, inputs=a, outputs=b, damping=(-1.0, 0.0)) for a, b in ((2, 3), (3, 2)))
    closed, omega = Closed.of(plant, law), np.array([0.03, 0.7, 5.0])
    for w, S, So, Q in zip(
        omega, closed.input_sensitivity.at(omega), closed.output_sensitivity.at(omega), closed.effort.at(omega), strict=True
    ):
        P, K = (ss(system)(np.exp(1j * w * 0.2)) for system in (plant, law))
        np.testing.assert_allclose(S, np.linalg.inv(np.eye(2) + K @ P), rtol=1e-6)
        np.testing.assert_allclose(So, np.linalg.inv(np.eye(3) + P @ K), rtol=1e-6)
        np.testing.assert_allclose(Q, K @ np.linalg.inv(np.eye(3) + P @ K), rtol=1e-6)
        np.testing.assert_allclose(closed.alone(1).at(np.array([w]))[0, 0, 0], S[1, 1], rtol=1e-9)


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize("n", [0, 3, 60])
def test_a_response_is_that_of_the_definition(n, dt):
    """Also of many states, with a delay of 30 samples among them and measurements in units of 1e6 and 1e-6."""
    random = np.random.default_rng(n)
    A, B, C, D = (random.standard_normal(shape) for shape in ((n, n), (n, 2), (3, n), (3, 2)))
    if n > 30:
        A[30:] = np.eye(n)[29:-1]
    C *= np.array([1e6, 1.0, 1e-6])[:, None]
    G = System(A, B, C, D, dt)
    for omega in (0.01, 1.0, 20.0):
        z = np.exp(1j * omega * dt) if dt else 1j * omega
        wanted = C @ np.linalg.inv(z * np.eye(n) - A) @ B + D
        np.testing.assert_allclose(G.at(np.array([omega]))[0], wanted, rtol=1e-8, atol=1e-12)
