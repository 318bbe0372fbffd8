"""Validity domains against the program that defines them, Qhull, plain geometry and exact fractions."""

import itertools
from fractions import Fraction

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.spatial import ConvexHull

from workbench.errors import InputError
from workbench.intervals.domains.aggregation import Relation, aggregate
from workbench.intervals.domains.choice import nearest
from workbench.intervals.domains.shadow import shadow
from workbench.intervals.domains.shapes import Box, Hull, domain_from_dict, outer_box

KINDS = {"points": 0.0, "equal": 0.2, "different": None}


def random_hull(rng, m, d, kind="points", offset=3.0):
    radii = rng.random((m, d)) * 0.4 if KINDS[kind] is None else KINDS[kind]
    return Hull(rng.standard_normal((m, d)) * (1 + rng.random(d)) + offset, radii)


def gauge_by_definition(points, radii, scale, x, radius):
    """min t s.t. V'l - R'l - t s <= x + rx, V'l + R'l + t s >= x - rx, 1'l = 1, l >= 0."""
    m = len(points)
    A = np.vstack([np.c_[(points - radii).T, -scale], np.c_[-(points + radii).T, -scale]])
    b = np.concatenate([x + radius, radius - x])
    return linprog(np.r_[np.zeros(m), 1.0], A, b, np.r_[np.ones(m), 0.0][None], [1.0], bounds=(0, None)).fun


def exact(array):
    return [[Fraction(float(v)) for v in row] for row in np.atleast_2d(array)]


def solves_exactly(columns, right):
    """The exact solution of sum_k l_k columns_k = right, or None where it is not unique; Gauss in fractions."""
    rows = [[c[i] for c in columns] + [right[i]] for i in range(len(right))]
    n = len(columns)
    for j in range(n):
        pivot = next((i for i in range(j, len(rows)) if rows[i][j] != 0), None)
        if pivot is None:
            return None
        rows[j], rows[pivot] = rows[pivot], rows[j]
        rows[j] = [v / rows[j][j] for v in rows[j]]
        for i in range(len(rows)):
            if i != j and rows[i][j] != 0:
                rows[i] = [a - rows[i][j] * b for a, b in zip(rows[i], rows[j], strict=True)]
    return None if any(row[n] != 0 for row in rows[n:]) else [rows[j][n] for j in range(n)]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("d", [1, 2, 3, 6, 7, 9])
def test_gauge_is_the_value_of_the_program_that_defines_it(d, kind):
    rng = np.random.default_rng(d)
    V = rng.standard_normal((40, d)) + 3
    R = rng.random((40, d)) * 0.4 if KINDS[kind] is None else np.full((40, d), KINDS[kind])
    hull = Hull(V, R)
    x, radius = rng.standard_normal((25, d)) * 4 + 3, rng.random((25, d)) * 0.2
    np.testing.assert_allclose(hull.scale, (V + R).max(axis=0) - (V - R).min(axis=0))
    for r in (np.zeros_like(x), radius):
        expected = [gauge_by_definition(V, R, hull.scale, a, b) for a, b in zip(x, r, strict=True)]
        assert max(expected) > 1e-3
        np.testing.assert_allclose(hull.gauge(x, r), expected, atol=1e-8)


@pytest.mark.parametrize("kind", KINDS)
def test_convex_combinations_of_boxes_are_inside(kind):
    rng = np.random.default_rng(4)
    V = rng.standard_normal((60, 7))
    R = rng.random((60, 7)) * 0.4 if KINDS[kind] is None else np.full((60, 7), KINDS[kind])
    share = rng.dirichlet(np.full(60, 0.1), 50)
    x = share @ V + rng.uniform(-1, 1, (50, 7)) * (share @ R)
    assert np.all(Hull(V, R).gauge(x) == 0)


@pytest.mark.parametrize("d", [2, 4, 6])
def test_inside_agrees_with_the_facets_of_qhull(d):
    rng = np.random.default_rng(d)
    V, x = rng.standard_normal((300, d)), rng.standard_normal((400, d))
    facets = ConvexHull(V).equations
    beyond = (x @ facets[:, :-1].T + facets[:, -1]).max(axis=1)
    inside = Hull(V).gauge(x) == 0
    assert 0 < inside.sum() < 400
    np.testing.assert_array_equal(inside, beyond <= 0)


def test_square_segment_and_triangle_have_the_gauges_of_geometry():
    square = Hull([[0, 0], [2, 0], [2, 4], [0, 4], [1, 2]])
    np.testing.assert_allclose(square.gauge([[1, 1], [2.5, 1], [-1, 6], [2, 4]]), [0, 0.25, 0.5, 0], atol=1e-9)
    segment = Hull([[0, 0], [1, 1]])
    np.testing.assert_allclose(segment.gauge([[0.3, 0.3], [0, 1], [2, 2]]), [0, 0.5, 1], atol=1e-9)
    triangle = Hull([[0, 0], [1, 0], [0, 1]])
    np.testing.assert_allclose(triangle.gauge([[0.75, 0.75]]), [0.25], atol=1e-9)


def test_an_interval_query_that_just_touches_is_inside():
    triangle = Hull([[0, 0], [1, 0], [0, 1]])
    x = np.array([[1.0, 1.0]] * 2)
    np.testing.assert_allclose(triangle.gauge(x, np.array([[0.5, 0.5], [0.4, 0.4]])), [0.0, 0.1], atol=1e-9)


def test_hull_of_boxes_is_the_hull_of_their_corners():
    rng = np.random.default_rng(8)
    V, R = rng.standard_normal((15, 3)), rng.random((15, 3))
    corners = np.vstack([V + np.array(sign) * R for sign in itertools.product((-1, 1), repeat=3)])
    x = rng.standard_normal((80, 3)) * 2
    np.testing.assert_allclose(Hull(V, R).gauge(x), Hull(corners).gauge(x), atol=1e-8)


@pytest.mark.parametrize("d", [3, 8])
def test_gauge_does_not_depend_on_units_or_origin(d):
    rng = np.random.default_rng(d)
    V, x = rng.standard_normal((50, d)), rng.standard_normal((30, d)) * 1.5
    unit, shift = 10.0 ** rng.integers(-5, 6, d), rng.standard_normal(d)
    np.testing.assert_allclose(Hull(V).gauge(x), Hull((V + shift) * unit).gauge((x + shift) * unit), atol=1e-8)


def test_flat_clouds_and_single_points_are_domains():
    rng = np.random.default_rng(3)
    for rank in (0, 1, 2):
        V = rng.standard_normal((30, rank)) @ rng.standard_normal((rank, 4)) + 1
        hull = Hull(V)
        assert np.all(hull.gauge(V) == 0)
        assert np.all(hull.gauge(rng.standard_normal((5, 4)) * 5) > 0.01)
    constant = Hull([[1.0, 0.0], [1.0, 1.0], [1.0, 1.0]])
    np.testing.assert_allclose(constant.scale, [1, 1])
    np.testing.assert_allclose(constant.gauge([[1.5, 0.5]]), [0.5])


@pytest.mark.parametrize("d", [2, 4, 7])
def test_a_yes_and_a_no_of_contains_hold_in_fractions(d):
    rng = np.random.default_rng(d)
    V = rng.standard_normal((60, d))
    hull = Hull(V)
    # combinations of points lie inside by construction, whatever the program says
    inner = Hull(rng.dirichlet(np.full(len(V), 0.3), 30) @ V * 0.95 + 0.05 * V.mean(axis=0))
    assert hull.contains(inner).answer is True
    assert hull.contains(hull).answer is not False
    far = V[np.argmax(np.linalg.norm(V, axis=1))] * 1.5
    outer = Hull(np.vstack([inner.points, far]))
    found = hull.contains(outer)
    assert found.answer is False
    np.testing.assert_allclose(found.witness, far)
    assert found.gauge == pytest.approx(hull.gauge(found.witness[None])[0], abs=1e-8)
    normal, offset = exact(found.separation.normal)[0], Fraction(found.separation.offset)
    assert all(sum(n * v for n, v in zip(normal, row, strict=True)) <= offset for row in exact(V))
    assert sum(n * v for n, v in zip(normal, exact(found.witness)[0], strict=True)) > offset


@pytest.mark.slow
def test_boxes_of_different_width_are_contained_as_their_corners_are():
    rng = np.random.default_rng(5)
    answers = []
    for _ in range(40):
        hull = random_hull(rng, 12, 3, "different", 0.0)
        other = Hull(rng.standard_normal((3, 3)) * 0.5, rng.random((3, 3)) * rng.random() * 1.2)
        signs = np.array(list(itertools.product((-1, 1), repeat=3)))
        corners = (other.points[:, None] + signs * other.radii[:, None]).reshape(-1, 3)
        answers.append(bool(np.all(hull.gauge(corners) == 0)))
        assert hull.contains(other).answer is answers[-1]
        assert hull.contains(other, 0.1).answer is bool(np.all(hull.gauge(corners) <= 0.1))
    assert 5 < sum(answers) < 35


def test_a_box_in_a_diamond_is_contained_although_no_sum_of_boxes_covers_it():
    diamond = Hull([[1, 0], [-1, 0], [0, 1], [0, -1]])
    assert diamond.contains(Box([-0.4, -0.4], [0.4, 0.4])).answer is True
    assert diamond.contains(Box([-0.6, -0.6], [0.6, 0.6])).answer is False


@pytest.mark.parametrize("d", [2, 5, 8])
def test_a_yes_and_a_no_of_meets_hold_in_fractions(d):
    rng = np.random.default_rng(d)
    answers = []
    for step in np.linspace(0, 4, 9):
        a, b = Hull(rng.standard_normal((25, d))), Hull(rng.standard_normal((25, d)) + step / np.sqrt(d) * 1.5)
        found = a.meets(b)
        answers.append(found.answer)
        if found.answer:
            used = [np.flatnonzero(w > 1e-12) for w in (found.first_weights, found.second_weights)]
            columns = [[*row, Fraction(1), Fraction(0)] for row in exact(a.points[used[0]])]
            columns += [[*[-v for v in row], Fraction(0), Fraction(1)] for row in exact(b.points[used[1]])]
            share = solves_exactly(columns, [Fraction(0)] * d + [Fraction(1)] * 2)
            assert share is None or min(share) > 0
            np.testing.assert_allclose(found.first_weights @ a.points, found.point, atol=1e-9)
            np.testing.assert_allclose(found.second_weights @ b.points, found.point, atol=1e-9)
        elif found.answer is False:
            normal, offset = exact(found.separation.normal)[0], Fraction(found.separation.offset)
            assert all(sum(n * v for n, v in zip(normal, row, strict=True)) <= offset for row in exact(a.points))
            assert all(sum(n * v for n, v in zip(normal, row, strict=True)) > offset for row in exact(b.points))
    assert answers[0] is True
    assert answers[-1] is False


def test_domains_that_touch_are_left_undecided():
    left, right = Hull([[0, 0], [1, 0.3], [0, 1.1]]), Hull([[2, 0], [0.5, 0.7], [2, 3]])
    assert left.meets(right).answer is None
    assert left.meets(Hull([[2.0, 0.0], [0.51, 0.71], [2.0, 3.0]])).answer is False


@pytest.mark.slow
def test_new_samples_of_a_regime_lie_near_the_hull_and_often_outside():
    rng = np.random.default_rng()
    hull, x = Hull(rng.standard_normal((1000, 8))), rng.standard_normal((300, 8))
    gauge = hull.gauge(x)
    assert np.mean(gauge == 0) < 0.75 < 0.9 < np.mean(gauge <= 0.1)
    assert np.all(hull.outer_gauge(x) <= gauge + 1e-9)


def test_nearest_is_the_first_smallest_gauge_and_holds_the_mode_where_asked():
    domains = [Box([0.0], [2.0]), Box([1.0], [3.0]), Hull([[5.0], [6.0]])]
    x = np.array([[2.5], [1.5], [0.5], [1.5], [4.5], [5.5]])
    np.testing.assert_array_equal(nearest(domains, x).index, [1, 0, 0, 0, 2, 2])
    np.testing.assert_array_equal(nearest(domains, x, hold=True).index, [1, 1, 0, 0, 2, 2])
    np.testing.assert_allclose(nearest(domains, x).gauge, [0, 0, 0, 0, 0.5, 0], atol=1e-9)


def test_nearest_agrees_with_the_full_table_of_gauges():
    rng = np.random.default_rng(11)
    domains = [Hull(rng.standard_normal((40, 4)) + 3 * rng.random(4)) for _ in range(6)]
    x = rng.standard_normal((120, 4)) * 2 + 1.5
    table = np.column_stack([domain.gauge(x) for domain in domains])
    found = nearest(domains, x)
    np.testing.assert_allclose(found.gauge, table.min(axis=1), atol=1e-8)
    np.testing.assert_array_equal(found.index, table.argmin(axis=1))


def always(a, b):
    return np.vstack([a, b])


def test_a_subset_merges_only_if_the_joint_data_keep_the_precision():
    rng = np.random.default_rng(2)
    big = rng.standard_normal((200, 3))
    small = big[:50] * 0.5
    merged = aggregate([small, big], Hull, always)
    assert merged.members == ((0, 1),)
    assert merged.decisions[0].first == (1,)
    # same hull, other dynamics: only the check of the precision tells them apart
    refused = aggregate([small, big], Hull, lambda a, b: None)
    assert [len(item) for item in refused.items] == [50, 200]
    assert [(d.relation, d.merged) for d in refused.decisions] == [(Relation.SUBSET, False)]
    assert "precision" in str(refused.decisions[0])


def test_intersecting_and_disjoint_domains_are_never_joined():
    def forbidden(a, b):
        raise AssertionError("joined")

    square = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    found = aggregate([square, square + 0.5, square + 5], Hull, forbidden)
    assert len(found.items) == 3
    relations = [d.relation for d in found.decisions]
    assert relations == [Relation.INTERSECTING, Relation.DISJOINT, Relation.DISJOINT]


def test_the_order_of_items_does_not_matter_for_clusters_far_apart():
    rng = np.random.default_rng(6)
    parts = [rng.uniform(-1, 1, (60, 3)) * size + 10 * k for k in range(3) for size in (1.0, 0.7, 0.5)]
    for _ in range(3):
        order = rng.permutation(9)
        found = aggregate([parts[k] for k in order], Hull, always)
        groups = {frozenset(int(order[k]) for k in group) for group in found.members}
        assert groups == {frozenset(range(3 * k, 3 * k + 3)) for k in range(3)}


def test_the_tolerance_decides_what_counts_as_inside():
    square = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    wider = np.vstack([square[:3] * 0.9, [[0.5, 1.05]]])
    assert len(aggregate([square, wider], Hull, always, tolerance=0.0).items) == 2
    assert len(aggregate([square, wider], Hull, always).items) == 1


def test_files_hold_plain_numbers_and_bring_the_domain_back():
    rng = np.random.default_rng(1)
    x = rng.standard_normal((20, 3)) * 2
    for domain in (random_hull(rng, 20, 3, "different", 0.0), Box([0, 0, 0], [1, 2, 3])):
        np.testing.assert_array_equal(domain_from_dict(domain.to_dict()).gauge(x), domain.gauge(x))
        np.testing.assert_array_equal(outer_box(domain).gauge(x), domain.outer_gauge(x))
    with pytest.raises(InputError, match="points and radii"):
        domain_from_dict({"points": []})


@pytest.mark.parametrize("kind", KINDS)
def test_a_shadow_reaches_as_far_as_the_domain_in_every_direction_of_its_plane(kind):
    rng = np.random.default_rng(9)
    hull = random_hull(rng, 25, 4, kind)
    polygon = shadow(hull, 3, 1)
    for angle in np.linspace(0, 2 * np.pi, 50):
        w = np.array([np.cos(angle), np.sin(angle)])
        reach = (hull.points[:, [3, 1]] @ w + hull.radii[:, [3, 1]] @ np.abs(w)).max()
        assert (polygon @ w).max() == pytest.approx(reach)
    edges = np.roll(polygon, -1, axis=0) - polygon
    turns = edges[:, 0] * np.roll(edges, -1, axis=0)[:, 1] - edges[:, 1] * np.roll(edges, -1, axis=0)[:, 0]
    assert np.all(turns > 0)
    assert len(shadow(Hull([[0, 0], [1, 1], [2, 2]]), 0, 1)) == 2


def test_bad_input_names_the_mend():
    for bad in (lambda: Hull([[np.inf]]), lambda: Hull([[1.0]], -1.0), lambda: Hull([[1.0, 2.0]], np.ones((3, 2))),
                lambda: Box([1.0], [0.0]), lambda: Hull([[1.0]]).gauge(np.zeros((2, 2))),
                lambda: Hull([[1.0]]).gauge([[np.nan]]), lambda: Hull([[1.0]]).meets(Box([0, 0], [1, 1])),
                lambda: nearest([], np.zeros((1, 1)))):  # fmt: skip
        with pytest.raises(InputError):
            bad()


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("kind", ["full", "two-valued", "plane", "line", "point", "with radii"])
def test_what_a_hull_holds_is_where_its_gauge_is_zero(kind, seed):
    """The quick test by facets against the program: on flat clouds, on facets, and a hair off them."""
    random = np.random.default_rng(seed)
    points = random.standard_normal((40, 4))
    if kind == "two-valued":
        points[:, 2:] = random.choice([-2.0, 2.0], (40, 2))
    if kind == "plane":
        points[:, 3] = points[:, 0] - 2 * points[:, 1] + 3.0
    if kind == "line":
        points = random.standard_normal((40, 1)) * np.array([1.0, 2.0, -1.0, 0.5]) + 1.0
    if kind == "point":
        points = np.tile(points[:1], (40, 1))
    hull = Hull(points, 0.3 if kind == "with radii" else 0.0)
    weights = random.dirichlet(np.full(40, 0.1), 30)
    within, random_step = weights @ points, random.standard_normal((30, 4))
    for size in (0.0, 1e-13, 1e-7, 1e-3, 1.0):
        x = within + size * random_step
        np.testing.assert_array_equal(hull.holds(x), hull.gauge(x) == 0.0)
    assert hull.holds(points).all()
    assert not hull.holds(points + 50.0).any()


def test_the_choice_of_a_mode_says_which_domains_hold_a_sample():
    left, right = Box(np.array([0.0, 0.0]), np.array([2.0, 1.0])), Box(np.array([1.0, 0.0]), np.array([3.0, 1.0]))
    x = np.array([[2.5, 0.5], [1.5, 0.5], [0.5, 0.5], [1.5, 0.5], [9.0, 0.5]])
    choice = nearest((left, right), x, hold=True)
    np.testing.assert_array_equal(choice.holds, [[False, True], [True, True], [True, False], [True, True], [False, False]])
    np.testing.assert_array_equal(choice.index, [1, 1, 0, 0, 1])
    assert choice.gauge[-1] == pytest.approx(3.0)
