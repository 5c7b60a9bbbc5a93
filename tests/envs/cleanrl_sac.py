"""Soft actor-critic in one file, in the style of CleanRL, for the current API of Gymnasium."""

from __future__ import annotations

import argparse
from collections.abc import Callable

import gymnasium as gym
import numpy as np
import torch
import torch.nn.functional as F
from stable_baselines3.common.buffers import ReplayBuffer
from torch import nn, optim

LOG_STD_MAX, LOG_STD_MIN = 2, -5


def parse_args(words: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    parser.add_argument("--env-id", default="Hopper-v5")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--num-envs", type=int, default=1)
    parser.add_argument("--capture-video", action="store_true")
    parser.add_argument("--total-timesteps", type=int, default=1_000_000)
    parser.add_argument("--buffer-size", type=int, default=1000)
    parser.add_argument("--gamma", type=float, default=0.99)
    parser.add_argument("--tau", type=float, default=0.005)
    parser.add_argument("--batch-size", type=int, default=256)
    parser.add_argument("--learning-starts", type=int, default=5000)
    parser.add_argument("--learning-rate", type=float, default=1e-3)
    parser.add_argument("--alpha", type=float, default=0.2)
    return parser.parse_args(words)


def make_env(env_id: str, index: int, capture_video: bool, run_name: str) -> Callable[[], gym.Env]:
    def thunk() -> gym.Env:
        if capture_video and index == 0:
            env = gym.make(env_id, render_mode="rgb_array")
            env = gym.wrappers.RecordVideo(env, f"videos/{run_name}")
        else:
            env = gym.make(env_id)
        return gym.wrappers.RecordEpisodeStatistics(env)

    return thunk


class SoftQNetwork(nn.Module):
    def __init__(self, env: gym.vector.VectorEnv) -> None:
        super().__init__()
        size = int(np.prod(env.single_observation_space.shape) + np.prod(env.single_action_space.shape))
        self.layers = nn.Sequential(nn.Linear(size, 32), nn.ReLU(), nn.Linear(32, 1))

    def forward(self, x: torch.Tensor, a: torch.Tensor) -> torch.Tensor:
        return self.layers(torch.cat([x, a], 1))


class Actor(nn.Module):
    def __init__(self, env: gym.vector.VectorEnv) -> None:
        super().__init__()
        inputs, self.outputs = (int(np.prod(s.shape)) for s in (env.single_observation_space, env.single_action_space))
        self.layers = nn.Sequential(nn.Linear(inputs, 32), nn.ReLU(), nn.Linear(32, 2 * self.outputs))
        high, low = env.single_action_space.high, env.single_action_space.low
        self.register_buffer("scale", torch.tensor((high - low) / 2.0, dtype=torch.float32))
        self.register_buffer("bias", torch.tensor((high + low) / 2.0, dtype=torch.float32))

    def get_action(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        mean, log_std = self.layers(x).chunk(2, dim=-1)
        log_std = LOG_STD_MIN + 0.5 * (LOG_STD_MAX - LOG_STD_MIN) * (torch.tanh(log_std) + 1)
        normal = torch.distributions.Normal(mean, log_std.exp())
        x_t = normal.rsample()
        y_t = torch.tanh(x_t)
        log_prob = normal.log_prob(x_t) - torch.log(self.scale * (1 - y_t.pow(2)) + 1e-6)
        return y_t * self.scale + self.bias, log_prob.sum(1, keepdim=True)


def main(words: list[str]) -> list[float]:
    """Train and return the episodic returns."""
    args = parse_args(words)
    torch.manual_seed(args.seed)
    envs = gym.vector.SyncVectorEnv(
        [make_env(args.env_id, i, args.capture_video, f"sac_{args.seed}") for i in range(args.num_envs)],
        autoreset_mode=gym.vector.AutoresetMode.SAME_STEP,
    )
    assert isinstance(envs.single_action_space, gym.spaces.Box), "only continuous action space is supported"
    actor, qf1, qf2, qf1_target, qf2_target = Actor(envs), *(SoftQNetwork(envs) for _ in range(4))
    qf1_target.load_state_dict(qf1.state_dict())
    qf2_target.load_state_dict(qf2.state_dict())
    q_optimizer = optim.Adam([*qf1.parameters(), *qf2.parameters()], lr=args.learning_rate)
    actor_optimizer = optim.Adam(actor.parameters(), lr=args.learning_rate)
    rb = ReplayBuffer(
        args.buffer_size, envs.single_observation_space, envs.single_action_space, "cpu",
        n_envs=args.num_envs, handle_timeout_termination=False,
    )  # fmt: skip
    returns: list[float] = []
    obs, _ = envs.reset(seed=args.seed)
    for global_step in range(args.total_timesteps):
        if global_step < args.learning_starts:
            actions = np.array([envs.single_action_space.sample() for _ in range(envs.num_envs)])
        else:
            actions = actor.get_action(torch.as_tensor(obs))[0].detach().numpy()
        next_obs, rewards, terminations, truncations, infos = envs.step(actions)
        if "final_info" in infos:
            episode = infos["final_info"]["episode"]
            returns += [float(r) for r, ended in zip(episode["r"], infos["_final_info"], strict=True) if ended]
        real_next_obs = next_obs.copy()
        for index in np.flatnonzero(terminations | truncations):
            real_next_obs[index] = infos["final_obs"][index]
        rb.add(obs, real_next_obs, actions, rewards, terminations, [{}] * args.num_envs)
        obs = next_obs
        if global_step <= args.learning_starts:
            continue
        data = rb.sample(args.batch_size)
        with torch.no_grad():
            next_actions, next_log_pi = actor.get_action(data.next_observations)
            next_q = torch.min(
                qf1_target(data.next_observations, next_actions), qf2_target(data.next_observations, next_actions)
            )
            target = data.rewards + (1 - data.dones) * args.gamma * (next_q - args.alpha * next_log_pi)
        qf_loss = F.mse_loss(qf1(data.observations, data.actions), target)
        qf_loss += F.mse_loss(qf2(data.observations, data.actions), target)
        q_optimizer.zero_grad()
        qf_loss.backward()
        q_optimizer.step()
        pi, log_pi = actor.get_action(data.observations)
        min_qf_pi = torch.min(qf1(data.observations, pi), qf2(data.observations, pi))
        actor_optimizer.zero_grad()
        (args.alpha * log_pi - min_qf_pi).mean().backward()
        actor_optimizer.step()
        for net, slow in ((qf1, qf1_target), (qf2, qf2_target)):
            for param, target_param in zip(net.parameters(), slow.parameters(), strict=True):
                target_param.data.lerp_(param.data, args.tau)
    envs.close()
    return returns


if __name__ == "__main__":
    import sys

    main(sys.argv[1:])
