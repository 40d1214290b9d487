"""The pictures of a page: they show the system, its target and outcomes, in the same bytes."""

import os
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
from mujoco.rendering.classic import gl_context
from PIL import Image

from study.common.arrays import Booleans, Floats, Pixels
from study.common.errors import BadInput, StudyError
from study.common.seeds import spawn
from study.data.trajectories import ScenarioSet
from study.envs import Simulator, simulators
from study.envs.card import fans, histogram
from study.envs.card.filmstrip import frames, plot_filmstrip
from study.envs.rendering import drawing
from study.envs.rendering.offscreen import renderer
from study.examples.cart import Cart

SIDE = 96
# A picture of nothing but the sky hardly changes along a row.
LEAST_CONTRAST = 3.0
# The target covers at least this share of the pixels of all frames together.
LEAST_TARGET = 1e-3


@cache
def _no_gl() -> str:
    try:
        renderer(Cart().scene(), 8, 8).close()
    except StudyError as error:
        return str(error)
    return ""


@pytest.fixture
def gl() -> None:
    """Skip without OpenGL; in continuous integration that is a failure."""
    if reason := _no_gl():
        pytest.fail(reason) if os.environ.get("CI") else pytest.skip(reason)


def _observe(simulator: Simulator, scenarios: int, rollouts: int) -> ScenarioSet:
    seeds = spawn(5, scenarios)
    sampled = simulator.sample_scenarios(seeds)
    actions = simulator.plan(sampled, seeds)
    rollout = simulator.rollout(
        np.repeat(sampled.s0, rollouts, axis=0),
        np.repeat(actions, rollouts, axis=0),
        spawn(6, scenarios * rollouts),
    )
    shape = (scenarios, rollouts, simulator.horizon, -1)
    unobserved = rollout.unobserved.reshape(scenarios, rollouts, -1)
    return ScenarioSet(
        sampled.s0, actions, sampled.goal, rollout.states[:, 1:].reshape(shape), unobserved, {}
    )


def _states(observed: ScenarioSet) -> Floats:
    """The first rollout of the first scenario, [T+1, D]."""
    return np.concatenate([observed.s0[:1], observed.observed[0, 0]])


def _contrast(picture: Pixels) -> float:
    """Mean standard deviation along the rows of a picture [H, W, 3], 0 to 255."""
    return float(picture.astype(float).std(axis=1).mean())


def _target(pictures: Pixels) -> Booleans:
    """Which pixels [..., H, W] have the bluish green of the target; grass does not have it."""
    red, green, _ = np.moveaxis(pictures.astype(int), -1, 0)
    return green - red > 50


@pytest.mark.usefixtures("gl")
@pytest.mark.parametrize("name", ["cart", "pusher", "uav"])
def test_every_frame_shows_the_system_and_its_target(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    simulator = simulators[name](horizon=12)
    observed = _observe(simulator, 1, 1)
    states, goal = _states(observed), observed.goal[0]
    shown = frames(simulator, states, goal, count=4, pixels=SIDE)
    assert shown.far.shape == (4, SIDE, SIDE, 3)
    np.testing.assert_allclose(shown.times, np.array([0, 4, 8, 12]) * simulator.control_step)
    assert min(_contrast(picture) for picture in shown.far) > LEAST_CONTRAST
    assert (shown.near is None) == (shown.enlarged == 1)
    if shown.near is not None:
        assert min(_contrast(picture) for picture in shown.near) > LEAST_CONTRAST

    monkeypatch.setattr(drawing, "add_target", lambda *_: None)
    without = frames(simulator, states, goal, count=4, pixels=SIDE)
    assert _target(shown.far).mean() > _target(without.far).mean() + LEAST_TARGET


@pytest.mark.usefixtures("gl")
def test_a_blank_picture_has_no_contrast() -> None:
    model = mujoco.MjModel.from_xml_string("<mujoco/>")
    data = mujoco.MjData(model)
    with renderer(model, SIDE, SIDE) as draw:
        draw.update_scene(data)
        assert _contrast(draw.render()) < LEAST_CONTRAST


@pytest.mark.usefixtures("gl")
def test_frames_are_marked_once_the_goal_is_reached() -> None:
    cart = Cart()
    states = np.zeros((21, 2), np.float32)
    states[:, 0] = np.linspace(0, 1, 21)
    shown = frames(cart, states, np.array([0.5], np.float32), count=5, pixels=16)
    # Steps 0, 5, 10, 15 and 20; at step 6 the cart is 0.2 m from its target.
    assert shown.reached.tolist() == [False, False, True, True, True]


@pytest.mark.usefixtures("gl")
def test_a_body_that_is_small_beside_its_path_is_enlarged() -> None:
    cart = Cart()
    goal = np.array([0.0], np.float32)
    states = np.zeros((21, 2), np.float32)
    states[:, 0] = np.linspace(0, 0.5, 21)
    assert frames(cart, states, goal, count=2, pixels=16).enlarged == 1
    states[:, 0] = np.linspace(0, 50, 21)
    assert frames(cart, states, goal, count=2, pixels=16).enlarged >= 20


@pytest.mark.usefixtures("gl")
def test_the_models_own_camera_shows_the_target_at_its_position(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><camera name="portrait" pos="0 0 3" xyaxes="1 0 0 0 1 0"/>
        <body><joint type="slide" axis="1 0 0"/><geom type="sphere" size=".1"/></body>
        </worldbody></mujoco>"""
    )
    monkeypatch.setattr(Cart, "scene", lambda self: model)
    # The camera sees 3 tan 22.5° = 1.24 m to either side.
    for x in (-0.8, 0.0, 0.8):
        states, goal = np.zeros((3, 2), np.float32), np.array([x], np.float32)
        shown = frames(Cart(horizon=2), states, goal, count=2, pixels=SIDE)
        rows, columns = np.nonzero(_target(shown.far[0]))
        expected = SIDE / 2 * (1 + x / (3 * np.tan(np.pi / 8)))
        assert columns.mean() == pytest.approx(expected, abs=3)
        assert rows.mean() == pytest.approx(SIDE / 2, abs=3)


@pytest.mark.usefixtures("gl")
def test_a_filmstrip_has_the_same_bytes_twice(tmp_path: Path) -> None:
    simulator = simulators["pusher"](horizon=8)
    observed = _observe(simulator, 1, 1)
    paths = [
        plot_filmstrip(simulator, _states(observed), observed.goal[0], tmp_path / name, count=3)
        for name in ("a.png", "b/c.png")
    ]
    assert paths[0].read_bytes() == paths[1].read_bytes()
    assert paths[0].stat().st_size < 300_000
    with Image.open(paths[0]) as picture:
        assert picture.width > 2.5 * picture.height


@pytest.mark.usefixtures("gl")
def test_a_picture_can_be_larger_than_the_models_buffer() -> None:
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><visual><global offwidth="16" offheight="16"/></visual></mujoco>'
    )
    with renderer(model, 40, 50) as draw:
        draw.update_scene(mujoco.MjData(model))
        assert draw.render().shape == (40, 50, 3)


@pytest.mark.parametrize(
    "failure", [ImportError("libEGL"), AttributeError("None"), mujoco.FatalError("no context")]
)
def test_missing_opengl_is_one_line(failure: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise failure

    monkeypatch.setattr(mujoco, "Renderer", fail)
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    with pytest.raises(StudyError, match=r"^OpenGL is not available\b.*$"):
        renderer(Cart().scene(), 8, 8)
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    with pytest.raises(StudyError, match=r"^OpenGL .*MUJOCO_GL=osmesa; unset it.*$"):
        renderer(Cart().scene(), 8, 8)


@pytest.mark.usefixtures("gl")
def test_the_renderer_does_not_change_mujocos_library() -> None:
    before = gl_context.GLContext
    renderer(Cart().scene(), 8, 8).close()
    assert gl_context.GLContext is before


def test_typical_scenarios_are_the_nearest_without_repetition() -> None:
    success = np.arange(10) < np.array([[5], [0], [9], [5], [10], [1]])
    assert fans.typical(success) == [5, 0, 2]
    assert fans.typical(success, (0.5, 0.5, 0.5, 0.2)) == [0, 3, 2, 5]
    assert fans.typical(success[:2]) == [1, 0]


def test_the_plotted_variables_have_the_most_variance_from_noise() -> None:
    cart = Cart()
    observed = _observe(cart, 4, 3)
    # The cart's x is what the plan view shows.
    assert fans.most_uncertain(cart, observed.observed) == ["v"]
    pusher = simulators["pusher"](horizon=4)
    # In four steps the arm does not touch the ball, so noise moves only the arm.
    moved = fans.most_uncertain(pusher, _observe(pusher, 4, 3).observed, count=2)
    assert not any(name.startswith("ball") for name in moved)


def test_fans_show_success_failure_and_target(tmp_path: Path) -> None:
    cart = Cart()
    observed = _observe(cart, 12, 10)
    paths = [fans.plot_fans(cart, observed, tmp_path / name) for name in ("a.png", "b.png")]
    assert paths[0].read_bytes() == paths[1].read_bytes()
    pixels = np.asarray(Image.open(paths[0]).convert("RGB")).astype(int)
    red, green, blue = pixels[..., 0], pixels[..., 1], pixels[..., 2]
    for shown in (blue - red > 60, red - blue > 60, (green - red > 30) & (green - blue > 15)):
        assert shown.mean() > 5e-4

    one = fans.plot_fans(cart, observed, tmp_path / "one.png", chosen=[3], variables=["x"])
    with Image.open(one) as row, Image.open(paths[0]) as three:
        assert 2 * row.height < three.height


def test_an_unknown_variable_is_refused(tmp_path: Path) -> None:
    cart = Cart()
    with pytest.raises(BadInput, match="no state variable 'y'"):
        fans.plot_fans(cart, _observe(cart, 3, 2), tmp_path / "a.png", variables=["y"])
    assert not list(tmp_path.iterdir())


def test_the_middle_bins_hold_the_uncertain_scenarios() -> None:
    rollouts = 10
    successes = np.arange(rollouts + 1)
    success = np.arange(rollouts) < successes[:, None]
    # 0 and 0.1 | 0.2 | 0.3 | 0.4 | none, for 0.5 counts above | 0.5 | 0.6 | 0.7 | 0.8 | 0.9 and 1.
    assert histogram.counts(success).tolist() == [2, 1, 1, 1, 0, 1, 1, 1, 1, 2]
    assert histogram.uncertain(success) == pytest.approx(7 / 11)
    generator = np.random.default_rng(0)
    for rollouts in (7, 60, 100):
        chance = generator.random((200, 1))
        success = generator.random((200, rollouts)) < chance
        counts = histogram.counts(success)
        assert counts.sum() == 200
        assert counts[1:-1].sum() == round(200 * histogram.uncertain(success))


def test_a_histogram_has_the_same_bytes_twice(tmp_path: Path) -> None:
    success = np.arange(10) < np.arange(10)[:, None]
    paths = [histogram.plot_histogram(success, tmp_path / name) for name in ("a.png", "b.png")]
    assert paths[0].read_bytes() == paths[1].read_bytes()
    other = histogram.plot_histogram(success[:-1], tmp_path / "c.png")
    assert other.read_bytes() != paths[0].read_bytes()
    with Image.open(other) as picture:
        assert _contrast(np.asarray(picture.convert("RGB"))) > LEAST_CONTRAST
