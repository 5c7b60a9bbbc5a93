"""State of the cells as the subtasks observe it: a frozen record of tensors, batch first."""

from __future__ import annotations

from dataclasses import MISSING, dataclass, fields
from functools import cached_property
from typing import Self

import torch
from torch import Tensor

OF_OBJECTS = {"objects", "kinds", "kind_places", "object_slots", "target"}
"""Fields of which the properties of State are made; they are kept until one of these is replaced."""


ABSENT = torch.empty(0)
"""Value of the fields of a hand in cells without a gripper."""


@dataclass(frozen=True)
class State:
    """One instant of N cells, or K of them. Tensors are float64 unless said otherwise; cell frame, SI units.

    The cell frame has its origin in the robot's base, z up. Every quantity belongs to the same
    instant: the last physics step of a control step, before it is integrated.

    Shapes are those of one instant. Of K instants a field that changes is (N, K, ...) and one that does not is
    (N, 1, ...): they broadcast, and functions of State take either.
    """

    joint_pos: Tensor
    """(N, J) rad."""
    joint_vel: Tensor
    """(N, J) rad/s."""
    joint_target: Tensor
    """(N, J) rad, targets of the position servos."""
    target_vel: Tensor
    """(N, J) rad/s, velocity of the targets."""
    share: Tensor
    """(N,) in [0, 1], part of the speed asked for that rating and shield passed in the last control step."""
    share_sum: Tensor
    """(N,) sum of `share` over the control steps of the episode."""
    braking: Tensor
    """(N,) bool, in the last control step the shield commanded the rated brake, or set-points were taken back to an arm
    that did not follow them."""
    protective_stops: Tensor
    """(N,) int64, how often in the episode `braking` began."""
    human_beyond_bound: Tensor
    """(N,) int64, control steps of the episode in which the person came nearer to a link than the shield assumes."""
    tcp_pos: Tensor
    """(N, 3) m, tool centre point."""
    tcp_home: Tensor
    """(N, 3) m, tool centre point with every joint at home."""
    joint_home: Tensor
    """(N, J) rad."""
    humans_pos: Tensor
    """(N, P, 2) m, vertical axes of the people. Without a human: one far away (`config.FAR_AWAY_M`)."""
    humans_yaw: Tensor
    """(N, P) rad."""
    humans_vel: Tensor
    """(N, P, 2) m/s, with which their axes moved in the last control step."""
    humans_stood: Tensor
    """(N, P) s since each person last walked, as the decision begins (`humans.walk.WALKING_M_S`)."""
    humans_side: Tensor
    """(N, P) which way round the robot they last walked, as the decision begins: 1 counter-clockwise, -1 clockwise,
    0 before they walk."""
    humans_seen: Tensor
    """(N, P, 2) m, their positions as the policy observes them (tracker, clipping, masking)."""
    humans_shown: Tensor
    """(N, P) bool, `humans_seen` is where they were measured, not clipped."""
    layout: Tensor
    """(N, F, 7) m and quaternion, poses of the cell's places (the middle of their tops), then of its obstacles."""
    tops: Tensor
    """(N, F, 6), tops of the places and obstacles: middle (3) m, half sides (2) m, turn about the vertical (1) rad."""
    arm_body: Tensor
    """(N, A, 7) m, the arm's capsules, but those of a gripper, as the decision begins: ends of the axis (6), radius
    (1)."""
    humans_body: Tensor
    """(N, Q, 7) m, the capsules of all people as last seen when the decision begins, as `arm_body`."""
    humans_body_vel: Tensor
    """(N, Q, 6) m/s, mean velocities of their ends over the decision before."""
    kind_places: Tensor
    """(N, kinds, 3) m, where the centre of an object of each kind belongs."""
    points: Tensor
    """(N, 2, 3) m, first and second point of `reach` and `point_to_point`."""
    objects: Tensor
    """(N, B, 3) m, centre of each object before it is picked; with a gripper, where it is now."""
    kinds: Tensor
    """(N, B) int64, index of its kind in `cell.objects`."""
    placed: Tensor
    """(N, B) bool, objects that are where they belong."""
    due: Tensor
    """(N, B) s of the episode by which each object is to be where it belongs; infinite in tasks without orders."""
    target: Tensor
    """(N,) int64, index of the object that is picked and placed next."""
    stage: Tensor
    """(N,) int64, index of the stage in force in the subtask's `stages`."""
    grasp_tolerance: Tensor
    """(N,) m, for reaching the object or a point."""
    place_tolerance: Tensor
    """(N,) m, for reaching where it belongs."""
    home_tolerance: Tensor
    """(N,) rad, of each joint, for being home."""
    level: Tensor
    """(N,) comfort level in force, constant over a decision; NaN without one (`comfort.source=none`)."""
    arm_distance: Tensor
    """(N,) m, smallest distance between any robot link and any body part; NaN where it is not measured."""
    home_distance: Tensor
    """(N,) m, `arm_distance` if the arm were at home; NaN where it is not measured."""
    touching: Tensor
    """(N,) bool, robot touches human."""
    contact: Tensor
    """(N,) bool, robot has touched human in this episode; of a subtask that repeats, in this decision."""
    unsafe_contact: Tensor
    """(N,) bool, and a contact began with the robot moving towards the human faster than
    `safety.separation.UNSAFE_SPEED_M_S`."""
    table_collision: Tensor
    """(N,) bool, robot touches a place, an obstacle, the pedestal or the floor."""
    self_collision: Tensor
    """(N,) bool."""
    steps: Tensor
    """(N,) int64, control steps since the episode began."""
    key: Tensor
    """(N,) int64, of the episode's random numbers for policies and options that draw (`policies.draws`)."""
    grip: Tensor = ABSENT
    """(N,) how far the hand is closed: 0 is open, 1 closed on nothing. This and all below with a gripper alone."""
    hand_body: Tensor = ABSENT
    """(N, H, 7) m, the capsules of the gripper and of what it may hold, as `arm_body`."""
    grip_vel: Tensor = ABSENT
    """(N,) 1/s, velocity of `grip`."""
    grip_target: Tensor = ABSENT
    """(N,) in [0, 1], set-point of the hand's drive."""
    tcp_quat: Tensor = ABSENT
    """(N, 4) orientation of the tool, w first: z away from the flange, x from one pad to the other."""
    objects_quat: Tensor = ABSENT
    """(N, B, 4) orientations of the objects, w first."""
    objects_vel: Tensor = ABSENT
    """(N, B, 3) m/s, velocities of their centres."""
    pads: Tensor = ABSENT
    """(N, B, 2) bool, the object touches the one pad and the other."""
    ground: Tensor = ABSENT
    """(N, B) m, height of the object's centre when no pad touched it last."""
    aloft_steps: Tensor = ABSENT
    """(N, B) int64, control steps for which the object has been in the hand, LIFT_M above `ground`."""
    free_steps: Tensor = ABSENT
    """(N, B) int64, control steps since a pad touched it last."""
    carried: Tensor = ABSENT
    """(N, B) bool, the object left the ground in the hand, and has not been let go since."""
    held_at: Tensor = ABSENT
    """(N, B, 3) m, centre of the object in the frame of the tool when it was carried first, or where it is now."""
    slip: Tensor = ABSENT
    """(N,) m, how far at most an object has shifted in the hand that carried it in this episode."""
    drops: Tensor = ABSENT
    """(N,) int64, how often in the episode an object left the hand farther from its place than the tolerance."""
    object_lost: Tensor = ABSENT
    """(N,) bool, an object lies on the floor or, of several, out of reach, or the physics diverged."""
    diverged: Tensor = ABSENT
    """(N,) bool, the physics diverged in this episode."""
    kind_sizes: Tensor = ABSENT
    """(N, kinds, 3) m, half the sides of an object of each kind."""
    object_slots: Tensor = ABSENT
    """(N, B, kinds, 3) m, where the centre of each of several objects belongs if it is of a kind: in a slot of its own;
    ABSENT of one alone."""

    @cached_property
    def object_places(self) -> Tensor:
        """(N, B, 3) m, where the centre of each object belongs."""
        if self.object_slots.shape == ABSENT.shape:
            return torch.take_along_dim(self.kind_places, self.kinds[..., None], dim=-2)
        return torch.take_along_dim(self.object_slots, self.kinds[..., None, None], dim=-2).squeeze(-2)

    @cached_property
    def target_object(self) -> Tensor:
        """(N, 3) m, centre of the target before it is picked."""
        return _of_target(self.objects, self.target)

    @cached_property
    def target_kind(self) -> Tensor:
        """(N,) int64, index of the target's kind in `cell.objects`."""
        return torch.take_along_dim(self.kinds, self.target[..., None], dim=-1).squeeze(-1)

    @cached_property
    def target_place(self) -> Tensor:
        """(N, 3) m, where the centre of the target belongs."""
        if self.object_slots.shape == ABSENT.shape:
            return _of_target(self.kind_places, self.target_kind)
        return _of_target(self.object_places, self.target)

    def fields(self) -> dict[str, Tensor]:
        """Return the fields by their names."""
        own = ((name, value) for name, value in vars(self).items() if name in State.__dataclass_fields__)
        return {name: value for name, value in own if name not in OF_HAND or value.shape != ABSENT.shape}

    def rows(self, index: Tensor) -> State:
        """Return the state of the rows that `index` (bool (N,) or int64) selects."""
        index = torch.nonzero(index).squeeze(1) if index.dtype == torch.bool else index
        return State(**{name: value.index_select(0, index) for name, value in self.fields().items()})

    def instants(self, **moving: Tensor) -> State:
        """Return instants (N, K, ...) of which the fields `moving` are given and others as in this one, K = 1."""
        still = {name: value[:, None] for name, value in self.fields().items() if name not in moving}
        return State.of(**still, **moving)

    def at(self, k: int) -> State:
        """Return instant `k` of several."""
        return State(**{name: value[:, min(k, value.shape[1] - 1)] for name, value in self.fields().items()})

    def with_(self, **changes: Tensor) -> Self:
        """Return a copy with the given fields replaced."""
        known = vars(self)
        if changes.keys() & OF_OBJECTS:
            known = self.fields()
        return self.of(**{**known, **changes})

    def put(self, index: Tensor, other: State) -> State:
        """Return a state whose rows at `index` (int64) are those of `other`; this one is unchanged."""
        theirs = other.fields()
        return State(**{name: mine.index_copy(0, index, theirs[name]) for name, mine in self.fields().items()})

    @classmethod
    def of(cls, **known: Tensor) -> Self:
        """Return a state of which some fields are known; to read another raises AttributeError."""
        state = object.__new__(cls)
        vars(state).update(known)
        return state


OF_HAND = {field.name for field in fields(State) if field.default is not MISSING}
"""Fields of cells with a gripper alone."""


def _of_target(each: Tensor, index: Tensor) -> Tensor:
    """Return the rows (N, 3) that `index` (N,) selects of `each` (N, n, 3)."""
    return torch.take_along_dim(each, index[..., None, None], dim=-2).squeeze(-2)
