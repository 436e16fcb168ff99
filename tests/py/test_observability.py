"""Observability: systems whose observable subspace is known in closed form, brute force, axes, units; the engine."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.linalg import expm

from gnssins import _core, plots
from gnssins.analysis import observability
from gnssins.analysis.stacking import c_en
from gnssins.errors import InputError
from gnssins.tables import State

S = 1_000_000_000
G = 9.81
AXES = ("n", "e", "d")
FOUR = ("phi_z", "gyro_bias_z", "accel_bias_x", "accel_bias_y")


@dataclass(frozen=True, eq=False)
class Model:
    """A linearisation made by hand."""

    t_ns: np.ndarray
    phi: np.ndarray
    h: np.ndarray
    r: np.ndarray
    q_nb: np.ndarray
    lla: np.ndarray
    states: tuple
    axes: str = "ned"


def states() -> tuple:
    quantities = (("phi", "rad"), ("dv", "m/s"), ("dp", "m"))
    nav = [State(f"{q}_{a}", unit, "navigation", "navigation") for q, unit in quantities for a in AXES]
    blocks = [State(f"{b}_{a}", "", b, b) for b in ("gyro_bias", "accel_bias") for a in "xyz"]
    return (*nav, *blocks)


def skew(v) -> np.ndarray:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]], dtype=np.float64)


def attitude(roll, pitch, heading) -> np.ndarray:
    return _core.quat_to_dcm(_core.euler_to_quat(np.array([[roll, pitch, heading]])))[0]


def model(
    angles=lambda t: (0.0, 0.0, 0.0),
    force=lambda t: (0.0, 0.0, -G),
    epochs=41,
    lever=(0, 0, 0),
    velocity=False,
):
    """Errors over a flat Earth that does not turn: phi' = -C b_g, dv' = [f x] phi + C b_a, dp' = dv; fixes at 10 Hz."""
    steps, dt = 10, 0.01
    n = len(states())
    t = np.arange(epochs) * 0.1
    phi, h = np.zeros((epochs, n, n)), np.full((epochs, 6, n), np.nan)
    for k in range(epochs):
        total = np.eye(n)
        for j in range(steps):
            now = t[k] + (j - steps + 0.5) * dt
            c = attitude(*angles(now))
            f = np.zeros((n, n))
            f[0:3, 9:12], f[3:6, 0:3], f[3:6, 12:15], f[6:9, 3:6] = -c, skew(force(now)), c, np.eye(3)
            total = expm(f * dt) @ total
        phi[k] = total
        h[k, :3] = np.hstack(
            [skew(attitude(*angles(t[k])) @ lever), np.zeros((3, 3)), np.eye(3), np.zeros((3, 6))]
        )
        if velocity:
            h[k, 3:] = np.hstack([np.zeros((3, 3)), np.eye(3), np.zeros((3, n - 6))])
    q = np.concatenate([_core.euler_to_quat(np.array([angles(x)])) for x in t])
    r = np.where(np.isfinite(h[:, :, :1]), np.eye(6) * [9e-4, 9e-4, 9e-4, 0.01, 0.01, 0.01], np.nan)
    lla = np.tile([0.8, 0.5, 100.0], (epochs, 1))
    return Model(np.rint(t * S).astype(np.int64), phi, h, r, q, lla, states())


def in_ecef(m: Model) -> Model:
    """The same errors along the axes of the Earth; the place stays the same."""
    turn = np.eye(len(m.states))
    for at in (0, 3, 6):
        turn[at : at + 3, at : at + 3] = c_en(m.lla[:1])[0]
    return replace(m, phi=turn @ m.phi @ turn.T, h=m.h @ turn.T, axes="ecef")


# ---- known subspaces


@pytest.mark.parametrize("heading", [0.0, 0.7, -2.5])
def test_level_and_straight_leaves_four_open_and_flags_those_of_the_publication(heading):
    found = observability(model(lambda t: (0.0, 0.0, heading)))
    assert len(found) == 11
    assert found.ranks() == {11: 1.0}
    assert found.flag_sets() == {FOUR: 1.0}
    assert found.ever_flagged == FOUR
    assert (found.fixes == 31).all()
    # a tilt of b/g looks like the bias b: the unit vector of the pair is (1, g) / sqrt(1 + g^2) in SI
    at = dict(zip(found.names, found.projection[0], strict=True))
    assert at["accel_bias_x"] == pytest.approx(G / np.hypot(1.0, G), abs=1e-9)
    assert at["phi_y"] == pytest.approx(1.0 / np.hypot(1.0, G), abs=1e-9)
    assert at["phi_z"] == pytest.approx(1.0, abs=1e-9)
    assert at["gyro_bias_x"] == pytest.approx(0.0, abs=1e-9)


def test_the_flag_of_the_tilt_depends_on_the_unit_of_the_bias():
    # GIVEN the bias in units of g instead of m/s^2 THEN tilt and bias share the doubt evenly and both are flagged
    m = model()
    scale = np.ones(15)
    scale[12:] = G
    scaled = replace(m, phi=m.phi * scale / scale[:, None], h=m.h * scale)
    found = observability(scaled)
    assert found.projection[0, 1] == pytest.approx(np.sqrt(0.5), abs=1e-9)
    assert set(found.ever_flagged) == {*FOUR, "phi_x", "phi_y"}


def test_an_uneven_turn_about_the_vertical_separates_tilt_from_bias_and_leaves_the_heading():
    found = observability(model(lambda t: (0.0, 0.0, 1.5 * np.sin(2.0 * t))))
    assert found.ranks() == {13: 1.0}
    assert found.flag_sets() == {("phi_z", "gyro_bias_z"): 1.0}


def test_an_even_turn_exchanges_the_doubt_between_the_level_gyros_and_accelerometers():
    # C b_a turns with the body, and so does g x the integral of C b_g: two of the six stay open beside the heading
    found = observability(model(lambda t: (0.0, 0.0, 1.5 * t)))
    assert found.ranks() == {11: 1.0}
    assert set(found.ever_flagged) == set(FOUR)


def test_an_uneven_turn_with_an_antenna_off_the_axis_shows_the_heading():
    lever = np.array([0.3, 0.0, 0.0])
    straight = observability(model(lever=lever))
    turning = observability(model(lambda t: (0.0, 0.0, 1.5 * np.sin(2.0 * t)), lever=lever))
    assert straight.flag_sets() == {FOUR: 1.0}
    assert turning.ranks() == {15: 1.0}
    assert turning.ever_flagged == ()


def test_a_change_of_velocity_shows_the_heading():
    # horizontal force that changes sign, so that no constant bias can stand for the heading
    found = observability(model(force=lambda t: (2.0 * np.sin(3.0 * t), 0.0, -G)))
    flags = set(found.ever_flagged)
    assert "phi_z" not in flags
    assert "gyro_bias_z" not in flags


def test_velocity_rows_do_not_change_what_is_open_on_a_straight():
    found = observability(model(velocity=True))
    assert found.ranks() == {11: 1.0}
    assert found.ever_flagged == FOUR


# ---- the matrix


def random_model(seed=1, epochs=40, gaps=True) -> Model:
    rng = np.random.default_rng(seed)
    n = len(states())
    phi = np.eye(n) + 0.1 * rng.normal(size=(epochs, n, n))
    h = rng.normal(size=(epochs, 6, n)) * (np.arange(n) < 9)
    root = rng.normal(size=(epochs, 6, 6)) + 3.0 * np.eye(6)
    r = root @ root.transpose(0, 2, 1)
    if gaps:
        h[rng.random(epochs) < 0.4, 3:] = np.nan
    q = rng.normal(size=(epochs, 4))
    q /= np.linalg.norm(q, axis=1)[:, None]
    t = np.cumsum(rng.integers(50, 150, epochs)) * 1_000_000
    lla = np.column_stack([rng.uniform(-1, 1, epochs), rng.uniform(-3, 3, epochs), np.zeros(epochs)])
    return Model(t, phi, h, r, q, lla, states())


def by_hand(m: Model, first: int, last: int, start=None, whiten=False) -> np.ndarray:
    rows, carried = [], np.eye(len(m.states)) if start is None else start
    for i in range(first, last + 1):
        carried = m.phi[i] @ carried if i > first else carried
        here = np.isfinite(m.h[i]).all(axis=1)
        h = m.h[i][here]
        if whiten:
            h = np.linalg.inv(np.linalg.cholesky(m.r[i][np.ix_(here, here)])) @ h
        rows.append(h @ carried)
    return np.vstack(rows)


def test_rank_singular_values_and_projection_are_those_of_the_matrix_built_row_by_row():
    m = random_model()
    found = observability(m, window=5, attitude_axes="model", threshold=2.0)
    assert len(found) == 36
    for k in range(len(found)):
        _, s, vt = np.linalg.svd(by_hand(m, k, k + 4))
        full = np.concatenate([s, np.zeros(15 - s.size)])
        np.testing.assert_allclose(found.singular_values[k], full, rtol=1e-9, atol=1e-9)
        rank = int((s >= 2.0).sum())
        assert found.rank[k] == rank
        np.testing.assert_allclose(found.projection[k], np.linalg.norm(vt[rank:], axis=0), atol=1e-8)
    assert np.array_equal(found.flags, found.projection > 0.5)
    assert found.first_s[3] == m.t_ns[3] / S
    assert found.t_s[3] == m.t_ns[7] / S


def test_sigma_scaling_takes_columns_times_prior_and_rows_over_the_noise():
    m = random_model(2)
    sd = np.random.default_rng(3).uniform(0.1, 2.0, 15)
    found = observability(m, window=4, attitude_axes="model", scaling="sigma", prior_sd=sd)
    assert found.threshold == 1.0
    for k in (0, 11, 36):
        expected = np.linalg.svd(by_hand(m, k, k + 3, whiten=True) @ np.diag(sd), compute_uv=False)
        np.testing.assert_allclose(found.singular_values[k, : expected.size], expected[:15], rtol=1e-9)


def test_the_prior_turns_with_the_axes():
    m, sd = random_model(4), np.linspace(0.1, 1.5, 15)
    found = observability(m, window=4, attitude_axes="body", scaling="sigma", prior_sd=sd)
    c = _core.quat_to_dcm(m.q_nb[:1])[0]
    start = np.diag(sd)
    start[:3, :3] = c @ np.diag(np.sqrt(np.diag(c.T @ np.diag(sd[:3] ** 2) @ c)))
    expected = np.linalg.svd(by_hand(m, 0, 3, start, whiten=True), compute_uv=False)
    np.testing.assert_allclose(found.singular_values[0, : expected.size], expected[:15], rtol=1e-9)


def test_one_known_figure_of_the_sigma_form():
    # GIVEN only the position is unknown, 10 m, and four fixes of 0.03 m THEN each direction gains sqrt(4) 10 / 0.03
    sd = np.zeros(15)
    sd[6:9] = 10.0
    found = observability(model(epochs=4), window=4, scaling="sigma", prior_sd=sd)
    np.testing.assert_allclose(found.singular_values[0, :3], 2.0 * 10.0 / 0.03, rtol=1e-12)
    assert found.ranks() == {3: 1.0}


@pytest.mark.parametrize("axes", ["body", "ned"])
def test_the_axes_of_the_model_do_not_matter(axes):
    m = model(lambda t: (0.2, -0.3, 1.1 * t), lambda t: (np.sin(t), 0.5, -G))
    a, b = observability(m, attitude_axes=axes), observability(in_ecef(m), attitude_axes=axes)
    assert a.names == b.names
    np.testing.assert_allclose(a.singular_values, b.singular_values, atol=1e-9)
    np.testing.assert_allclose(a.projection, b.projection, atol=1e-6)
    sd = np.linspace(0.1, 1.5, 15)
    sigma = [observability(x, attitude_axes=axes, scaling="sigma", prior_sd=sd) for x in (m, in_ecef(m))]
    np.testing.assert_allclose(sigma[0].singular_values, sigma[1].singular_values, rtol=1e-9)


def test_the_axes_change_the_flags_of_the_attitude_and_not_the_rank():
    # GIVEN a body whose x axis points down THEN the heading is its x component
    m = model(lambda t: (0.0, -0.5 * np.pi, 0.0))
    body, ned = observability(m), observability(m, attitude_axes="ned")
    assert np.array_equal(body.rank, ned.rank)
    assert "phi_x" in body.ever_flagged
    assert "phi_d" in ned.ever_flagged
    assert not {"phi_y", "phi_z"} & set(body.ever_flagged)
    model_axes = observability(in_ecef(m), attitude_axes="model").names
    assert model_axes[:4] == ("phi_ecef_x", "phi_ecef_y", "phi_ecef_z", "dv_ecef_x")


def test_a_window_in_seconds_takes_the_fixes_that_fall_into_it():
    m = model()
    a, b = observability(m), observability(m, window_s=3.0)
    assert np.array_equal(a.singular_values, b.singular_values)
    assert np.array_equal(a.t_s, b.t_s)
    uneven = random_model(5)
    found = observability(uneven, window_s=1.0, attitude_axes="model", threshold=0.5)
    assert found.fixes.min() < found.fixes.max()
    assert ((found.t_s - found.first_s) <= 1.0 + 1e-6).all()
    k = int(found.fixes.argmin())
    first, last = (np.searchsorted(uneven.t_ns, round(x[k] * S)) for x in (found.first_s, found.t_s))
    expected = np.linalg.svd(by_hand(uneven, first, last), compute_uv=False)[:15]
    np.testing.assert_allclose(found.singular_values[k, : expected.size], expected, rtol=1e-9)


# ---- what comes out


def test_tables_and_cuts():
    found = observability(model())
    assert "gyro_bias_z" in found.table()
    assert "rank of 15: 11: 100 %" in found.table()
    plain = found.to_dict()
    assert plain["rank_share"] == {"11": 1.0}
    assert plain["flagged_share"]["phi_z"] == 1.0
    part = found.between(0.2, 3.6)
    assert part.first_s[0] == 0.2
    assert part.t_s[-1] == 3.6
    assert len(part) == 5
    with pytest.raises(InputError, match="no window"):
        found.between(100.0, 200.0).table()


def test_the_figure_shows_every_state():
    figure = plots.observability(observability(model()))
    assert isinstance(figure, Figure)
    rank, picture = figure.axes[:2]
    assert [label.get_text() for label in picture.get_yticklabels()] == list(observability(model()).names)
    assert rank.lines[0].get_ydata().tolist() == [11] * 11
    with pytest.raises(InputError, match="no window"):
        plots.observability(observability(model()).between(50.0, 60.0))


@pytest.mark.parametrize(
    ("options", "code"),
    [
        ({"window": 42}, "input.window"),
        ({"window_s": 60.0}, "input.window"),
        ({"window": 0}, "input.window"),
        ({"window_s": float("nan")}, "input.window"),
        ({"attitude_axes": "enu"}, "input.axes"),
        ({"scaling": "mg"}, "input.scaling"),
        ({"threshold": 0.0}, "input.threshold"),
        ({"flag": 1.0}, "input.threshold"),
        ({"scaling": "sigma"}, "input.no_prior"),
        ({"scaling": "sigma", "prior_sd": np.ones(9)}, "input.no_prior"),
        ({"scaling": "sigma", "prior_sd": -np.ones(15)}, "input.no_prior"),
    ],
)
def test_what_cannot_be_analysed_is_refused(options, code):
    with pytest.raises(InputError) as caught:
        observability(model(), **options)
    assert caught.value.code == code
    assert caught.value.hint


def test_no_fix_and_unknown_axes_are_refused():
    m = model()
    with pytest.raises(InputError, match="no epoch has a measurement"):
        observability(replace(m, h=np.full_like(m.h, np.nan)))
    with pytest.raises(InputError, match='axes "enu"'):
        observability(replace(m, axes="enu"))
