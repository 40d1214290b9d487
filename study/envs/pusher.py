"""The Pusher of section V-A: a two-link arm on a table pushes a ball to a target."""

from pathlib import Path
from typing import ClassVar

import mujoco
import numpy as np
from mujoco.rollout import Rollout as Physics

from study.envs.pusher_policy import Habits, arm_end, push
from study.envs.simulator import (
    Doubles,
    Floats,
    Rollout,
    Scenarios,
    Simulator,
    Variable,
    simulators,
)
from study.seeds import Seeds

MODEL = Path(__file__).with_name("pusher.xml")
CHUNK = 256
CANDIDATES = 64


@simulators.register("pusher")
class Pusher(Simulator):
    name = "pusher"
    version = 1
    state = tuple(Variable(str(i), "m", "x") for i in range(12))
    action = (
        Variable("upper_torque", "N·m", "torque on the shoulder", -0.05, 0.05),
        Variable("lower_torque", "N·m", "torque on the elbow", -0.05, 0.05),
    )
    hidden: ClassVar[tuple[Variable, ...]] = ()
    task = (Variable("target_x", "m", ""), Variable("target_y", "m", ""))
    default_horizon = 120
    control_step = 0.02
    radius = 0.025

    torque_noise = 0.004
    gamma_start = (0.6, 2.4)
    ball_start = (0.07, 0.15)
    target_start = (0.05, 0.17)
    travel = (0.07, 0.14)
    clearance = 0.05
    attempts = 3

    def __init__(self, horizon: int | None = None, threads: int = 1) -> None:
        super().__init__(horizon, threads)
        self.model = mujoco.MjModel.from_xml_path(str(MODEL))
        self.substeps = round(self.control_step / self.model.opt.timestep)
        self.ball_height = float(self.model.body("ball").pos[2])
        self.bound = np.array([variable.high for variable in self.action], np.float32)

    def draw(self, seeds: Seeds) -> Scenarios:
        u = np.stack([np.random.default_rng([int(s), 0]).random((CANDIDATES, 7)) for s in seeds])
        def scale(i, rng): return rng[0] + (rng[1] - rng[0]) * np.ascontiguousarray(u[..., i])
        theta = scale(0, (-np.pi, np.pi))
        gamma = np.where(u[..., 1] < 0.5, -1, 1) * scale(2, self.gamma_start)
        br, ba = scale(3, self.ball_start), scale(4, (-np.pi, np.pi))
        tr, ta = scale(5, self.target_start), scale(6, (-np.pi, np.pi))
        x, y = arm_end(theta, gamma)
        bx, by, tx, ty = br * np.cos(ba), br * np.sin(ba), tr * np.cos(ta), tr * np.sin(ta)
        d = np.hypot(tx - bx, ty - by)
        qx, qy = bx - .045 * (tx - bx) / d, by - .045 * (ty - by) / d
        ok = (np.hypot(x - bx, y - by) >= self.clearance) & (d >= self.travel[0]) & (d <= self.travel[1]) & (np.hypot(qx, qy) <= 0.185) & (np.hypot(qx, qy) > 0.04)
        assert ok.any(1).all()
        first = ok.argmax(1)
        pick = lambda a: a[np.arange(len(seeds)), first]
        qpos = np.stack([pick(a) for a in (theta, gamma, bx, by)], 1)
        s0 = self._observe(qpos, np.zeros_like(qpos))
        return Scenarios(s0, np.stack([pick(tx), pick(ty)], 1).astype(np.float32))

    def plan(self, scenarios: Scenarios, seeds: Seeds) -> Floats:
        actions = np.empty((len(seeds), self.horizon, 2), np.float32)
        todo = np.arange(len(seeds))
        for attempt in range(self.attempts):
            h = Habits.draw(seeds[todo], attempt, self.horizon)
            actions[todo], done = self._attempt(scenarios.s0[todo], scenarios.task[todo], h)
            todo = todo[~done]
            if not len(todo): break
        return actions

    def _attempt(self, s0, task, habits):
        x = self._physics_state(s0)
        actions = np.empty((len(s0), self.horizon, 2), np.float32)
        damping = float(self.model.dof_damping[0])
        done = np.zeros(len(s0), bool)
        target = task.astype(np.float64)
        data = [mujoco.MjData(self.model) for _ in range(max(self.threads,1))]
        with Physics(nthread=self.threads if self.threads > 1 else 0) as ph:
            for t in range(self.horizon):
                s = self._observe64(x[:, 1:5], x[:, 5:9])
                a = push(s, target, habits, t, damping, 0.3 * self.radius)
                actions[:, t] = np.clip(a, -self.bound, self.bound)
                ctrl = np.repeat(actions[:, t:t+1].astype(np.float64), self.substeps, 1)
                out, _ = ph.rollout(self.model, data, x, ctrl)
                x = out[:, -1]
                done |= np.hypot(x[:, 3]-target[:, 0], x[:, 4]-target[:, 1]) <= 0.6*self.radius
        return actions, done

    def _physics_state(self, s0):
        s = np.ascontiguousarray(s0.T.astype(np.float64))
        x, y, ct, st, wt, cg, sg, wg, bx, by, vx, vy = s
        return np.stack([0*x, np.arctan2(st, ct), np.arctan2(sg, cg), bx, by, wt, wg, vx, vy], 1)

    def _observe64(self, qpos, qvel):
        theta, gamma, bx, by = np.ascontiguousarray(np.moveaxis(qpos, -1, 0))
        wt, wg, vx, vy = np.moveaxis(qvel, -1, 0)
        x, y = arm_end(theta, gamma)
        return np.stack([x, y, np.cos(theta), np.sin(theta), wt, np.cos(gamma), np.sin(gamma), wg, bx, by, vx, vy], -1)

    def _observe(self, qpos, qvel):
        return self._observe64(qpos, qvel).astype(np.float32)

    def rollout(self, s0, actions, seeds, noise=True):
        T = actions.shape[1]
        states = np.empty((len(s0), T + 1, 12), np.float32)
        states[:, 0] = s0
        data = [mujoco.MjData(self.model) for _ in range(max(self.threads,1))]
        with Physics(nthread=self.threads if self.threads > 1 else 0) as ph:
            for i in range(0, len(s0), CHUNK):
                sl = slice(i, i+CHUNK)
                tau = np.clip(actions[sl], -self.bound, self.bound).astype(np.float64)
                if noise:
                    tau += self.torque_noise * np.stack([np.random.default_rng([int(s), 2]).standard_normal((T, 2)) for s in seeds[sl]])
                out, _ = ph.rollout(self.model, data, self._physics_state(s0[sl]), np.repeat(tau, self.substeps, 1))
                out = out[:, self.substeps-1::self.substeps]
                states[sl, 1:] = self._observe(out[..., 1:5], out[..., 5:9])
        return Rollout(states, np.empty((len(s0), 0), np.float32))

    def position(self, states):
        z = np.full((*states.shape[:-1], 1), self.ball_height, np.float32)
        return np.concatenate([states[..., 8:10], z], -1)

    def target(self, task):
        z = np.full((*task.shape[:-1], 1), self.ball_height, np.float32)
        return np.concatenate([task, z], -1)

    def scene(self): return self.model

    def configuration(self, states):
        return self._physics_state(states)
