"""Every simulator as a Gymnasium environment: the same dynamics, one trajectory, step by step.

::

    import gymnasium, study.envs
    env = gymnasium.make("study/Pusher-v0", render_mode="rgb_array")
"""

from typing import Any

import gymnasium
import mujoco
import numpy as np
from gymnasium.spaces import Box

from study.common.arrays import Array, Doubles, Floats, Pixels
from study.common.errors import StudyError
from study.data.minari import Transitions
from study.data.trajectories import Trajectories
from study.data.variables import bounds
from study.envs.rendering import drawing
from study.envs.rendering.offscreen import renderer
from study.envs.simulator import Episode, Scenarios, simulators

WIDTH, HEIGHT = 640, 480


class SimulatorEnv(gymnasium.Env[Floats, Doubles]):
    """One trajectory of a simulator.

    *Observation*, [D + G] float32: the state, then the goal, in SI units. The simulator's `state`
    and `goal` name the components.

    *Action*, [A] float64: the components of the simulator's action, scaled so that their bounds are
    −1 and 1. Values beyond these are clipped. Values that are not finite are refused.

    *Reward*: 1 at the step at which the goal is first reached, otherwise 0. So the return is the
    outcome whose probability the study forecasts.

    *End*: an episode is truncated after the horizon. It never terminates before, since a forecast
    covers the whole horizon.

    *Info*: ``unobserved`` [H] float32, and ``success``, whether the goal has been reached.

    *Reset options*: ``scenario`` and ``noise`` are seeds of the batched simulator. They repeat
    ``simulator.sample_scenarios([scenario])`` and ``simulator.rollout(s0, actions, [noise])``
    exactly. ``noise=None`` is the nominal system.

    Args:
        simulator: registered name of the simulator.
        horizon: control steps T; None is the simulator's own.
        render_mode: None or ``rgb_array``.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012

    def __init__(
        self, simulator: str, horizon: int | None = None, render_mode: str | None = None
    ) -> None:
        self.simulator = simulators[simulator](horizon)
        self.metadata = self.metadata | {"render_fps": 1 / self.simulator.control_step}
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode: got '{render_mode}'; it must be 'rgb_array' or None")
        self.render_mode = render_mode
        low, high = bounds((*self.simulator.state, *self.simulator.goal))
        self.observation_space = Box(low.astype(np.float32), high.astype(np.float32))
        # Float64, so that scaling an action and scaling it back gives the same float32.
        size = (len(self.simulator.action),)
        self.action_space = Box(-1.0, 1.0, size, np.float64)
        self._low, self._high = bounds(self.simulator.action)
        self._episode: Episode | None = None
        self._scenario: Scenarios
        self._state: Floats
        self._renderer: mujoco.Renderer | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats, dict[str, Any]]:
        """Begin a new scenario, sampled with `seed` or named by `options`."""
        super().reset(seed=seed)
        sampled = self.np_random.integers(2**64, size=2, dtype=np.uint64)
        seeds = {"scenario": sampled[0], "noise": sampled[1]} | (options or {})
        if unknown := seeds.keys() - {"scenario", "noise"}:
            raise ValueError(f"options: got {sorted(unknown)}; allowed are 'scenario' and 'noise'")
        noise = seeds["noise"]
        self._scenario = self.simulator.sample_scenarios(np.array([seeds["scenario"]], np.uint64))
        self._state = self._scenario.s0
        self._episode = self.simulator.start_episode(
            self._state, None if noise is None else np.array([noise], np.uint64)
        )
        self._steps, self._success = 0, False
        return self._observation(), self._info()

    def step(self, action: Array) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        """Hold the action [A] for one control step.

        Raises:
            ValueError: the action has another shape, or is not finite.
        """
        if self._episode is None:
            raise RuntimeError("call reset before the first step")
        action = np.asarray(action, np.float64)
        if action.shape != self.action_space.shape:
            wanted = self.action_space.shape
            raise ValueError(f"action: got the shape {action.shape}; it must be {wanted}")
        if not np.isfinite(action).all():
            raise ValueError(f"action: got {action}; it must be finite")
        self._state = self._episode.step(self.physical(action)[None])
        self._steps += 1
        reached = bool(self.simulator.outcome(self._state[:, None], self._scenario.goal)[0])
        reward = float(reached and not self._success)
        self._success |= reached
        truncated = self._steps >= self.simulator.horizon
        return self._observation(), reward, False, truncated, self._info()

    def physical(self, action: Array) -> Floats:
        """Scaled actions [..., A] to SI units."""
        middle, half = (self._high + self._low) / 2, (self._high - self._low) / 2
        return self.simulator.clip_actions(middle + half * np.asarray(action, np.float64))

    def scaled(self, action: Floats) -> Doubles:
        """Actions [..., A] in SI units to scaled ones, between −1 and 1."""
        middle, half = (self._high + self._low) / 2, (self._high - self._low) / 2
        return np.asarray(np.clip((action.astype(np.float64) - middle) / half, -1.0, 1.0))

    def transitions(self, trajectories: Trajectories) -> Transitions:
        """What stepping this environment through the trajectories gives."""
        states, goal = trajectories.states, trajectories.goal
        count, horizon = trajectories.actions.shape[:2]
        goals = np.broadcast_to(goal[:, None], (count, horizon + 1, goal.shape[-1]))
        # Whether each single state is at the goal, [N, T].
        at_goal = self.simulator.outcome(states[:, 1:, None], goal[:, None])
        truncations = np.zeros((count, horizon), np.bool_)
        truncations[:, -1] = True
        return Transitions(
            observations=np.concatenate([states, goals], axis=-1),
            actions=self.scaled(trajectories.actions),
            rewards=(at_goal & (at_goal.cumsum(axis=1) == 1)).astype(np.float64),
            terminations=np.zeros((count, horizon), np.bool_),
            truncations=truncations,
        )

    def render(self) -> Pixels | None:
        """The scene with the target, [480, 640, 3]; None without a render mode.

        Raises:
            StudyError: the system has no scene, or OpenGL is not available.
        """
        if self.render_mode is None or self._episode is None:
            return None
        if self._renderer is None:
            scene = self.simulator.scene()
            if scene is None:
                raise StudyError(f"{self.simulator.title} has no MuJoCo scene and cannot be drawn")
            self._scene = scene
            self._renderer = renderer(self._scene, HEIGHT, WIDTH)
        configuration = self.simulator.configuration(self._state)[0]
        camera = 0 if self._scene.ncam else -1
        self._renderer.update_scene(drawing.pose(self._scene, configuration), camera)
        target = self.simulator.target(self._scenario.goal)[0].astype(np.float64)
        radius = self.simulator.radius
        drawing.add_target(self._renderer.scene, target, radius, 6 * radius)
        return np.array(self._renderer.render())

    def close(self) -> None:
        """Free the renderer."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _observation(self) -> Floats:
        return np.concatenate([self._state[0], self._scenario.goal[0]])

    def _info(self) -> dict[str, Any]:
        assert self._episode is not None
        return {"unobserved": self._episode.unobserved[0].copy(), "success": self._success}
