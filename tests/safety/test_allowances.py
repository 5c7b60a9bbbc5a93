"""Allowances of the shield are exact, and configurations that exceed it are refused."""

from __future__ import annotations

import pytest

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError
from hrl_comfort.files.run_config import environment
from hrl_comfort.safety.allowances import check_allowances

SHIELDED = ("robot.rating=collaborative", "safety=ssm", "safety.bound=worst")


@pytest.mark.parametrize(("rate_hz", "delay_s"), [(50, 0.02), (49, 0.04), (25, 0.04), (12, 0.1)])
def test_frames_that_come_with_control_steps_are_older_than_the_trackers_period(rate_hz: float, delay_s: float) -> None:
    asked = [*SHIELDED, f"randomise.person_rate_hz=[{rate_hz},{rate_hz}]", "randomise.person_noise_m=[0,0.001]"]
    check_allowances(environment(compose("train", [*asked, f"safety.delay_s={delay_s}"])))
    with pytest.raises(ConfigError, match=f"give at least safety.delay_s={delay_s:g}"):
        check_allowances(environment(compose("train", [*asked, f"safety.delay_s={delay_s - 0.01}"])))


@pytest.mark.parametrize("asked", [["human=worker"], ["human=mixture", "human.mixture={patrol:{speed_m_s:2.0}}"]])
def test_people_who_walk_faster_than_the_shield_assumes_are_refused(asked: list[str]) -> None:
    speed = [] if "mixture" in asked[0] else ["human.speed_m_s=2.0"]
    with pytest.raises(ConfigError, match=r"human.speed_m_s=2 is more than the shield assumes; give safety.human_spee"):
        check_allowances(environment(compose("train", [*SHIELDED, *asked, *speed])))
    check_allowances(environment(compose("train", [*SHIELDED, *asked, *speed, "safety.human_speed_m_s=2"])))
