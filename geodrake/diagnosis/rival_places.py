"""Where an effect acts that is taken for another one, which may be bound to another kind of place.

A step at a joint may have a rival on a body, as a compensator of gravity has a payload: the rival
is then on the body that the joint moves. Around the other way it is at the joint that carries the
body.
"""

from __future__ import annotations

from collections.abc import Sequence

from geodrake.effects.base import Effect
from geodrake.model.robot_model import RobotModel

Place = tuple[str, ...]


def place_of_rival(
    effect: type[Effect], where: Sequence[str], rival: type[Effect], model: RobotModel
) -> Place | None:
    """The place of a rival, from that of the effect that it is taken for.

    Args:
        effect: The effect.
        where: Its joints, or its body first; empty if it is one of the whole robot.
        rival: The rival.
        model: The robot.

    Returns:
        Joints or a body; empty for the whole robot or everywhere; None where no place is known.
    """
    if rival.places == "robot":
        return ()
    if rival.places == effect.places:
        return tuple(where)
    joints = _joints(effect, where, model)
    if joints is None:
        return None
    if rival.places == "body":
        return _body(joints, model)
    if rival.places == "joint_pair":
        return _pair(joints, model)
    left_out = model.sliding_joints if rival.turning_only else ()
    kept = tuple(joint for joint in joints if joint not in left_out)
    return kept if kept or not joints else None


def _moved(model: RobotModel) -> dict[str, str]:
    """Joint of one degree of freedom -> body that it moves, the robot's base first."""
    moves = {
        model.joints[at]: model.bodies[mobilizer.body]
        for mobilizer in model.joint_tree.mobilizers
        if mobilizer.body >= 0 and (at := model.standing(mobilizer.velocities)) >= 0
    }
    return {joint: body for joint, body in moves.items() if joint in model.single_joints}


def _joints(effect: type[Effect], where: Sequence[str], model: RobotModel) -> Place | None:
    """Joints that an effect acts at, or that carry its body; empty for all, None for none."""
    if effect.places != "body":
        return tuple(where)
    carrying = tuple(joint for joint, body in _moved(model).items() if body in where[:1])
    return carrying or None


def _body(joints: Place, model: RobotModel) -> Place | None:
    """The body that the last of some joints moves; of all joints, the robot's last if it has one.

    Args:
        joints: The joints; all if empty.
        model: The robot.
    """
    bodies = [body for joint, body in _moved(model).items() if joint in joints]
    if not joints and len(model.last_bodies) == 1:
        bodies = list(model.last_bodies)
    return tuple(bodies[-1:]) or None


def _pair(joints: Place, model: RobotModel) -> Place | None:
    """A pair of joints with one or both of those given; empty for all pairs, None for none."""
    pairs = model.joint_pairs
    within = [pair for pair in pairs if set(pair) <= set(joints)]
    touching = [pair for pair in pairs if set(pair) & set(joints)]
    if pairs and (not joints or len(within) > 1):
        return ()
    return next(reversed(within or touching), None)
