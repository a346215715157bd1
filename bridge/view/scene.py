"""What the view shows, as triangles: bodies, floor, trail (the paper's figure 8). No drawing here.

The camera stands still and the world moves: everything is placed in the camera's rig, x to the
right, y away from the camera, z up, with the body's middle over the origin and the body turned as
the viewpoint says. So the light stays with the camera, and the mouse may turn it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from bridge.body_frame import CONSTRUCTIONS, PAPER_FRAME, REFERENCES, SIX_FRAME
from bridge.humanoid.rotations import matrices
from bridge.humanoid.solver import HumanoidSolver
from bridge.model import ModelInfo
from bridge.pose import Pose, Provenance
from bridge.truth import rms_mm
from bridge.view import mesh
from bridge.view.body import Body, Bones, Colours
from bridge.view.camera import VIEWPOINTS, Camera
from bridge.view.colours import (
    BACKGROUND,
    CYAN,
    GOLD,
    GREEN,
    GREY,
    ICE,
    ORANGE,
    PALE,
    VIOLET,
    WHITE,
    Colour,
)  # fmt: skip
from bridge.view.controls import Look
from bridge.view.mesh import Array, Mesh, or_nothing
from bridge.view.player import TRAIL_POINTS, Moment
from bridge.view.skeleton import stick_rows
from bridge.view.world import SQUARES, Floor, Follow, Trail, share
from drivers.frame import Floats

_SHADOW: Colour = (0.04, 0.048, 0.065)

# By provenance.
_SPHERES = np.array([ICE, ORANGE, CYAN, GREY])
_STICKS = np.array([CYAN, ORANGE, CYAN, GREY])

# Metres.
APART = 0.62  # each body from the middle
_DISC, _RIM = 0.030, 0.007
_LIFT = 0.025  # of a disc towards the camera, out of its own sphere and sticks

_ERROR_LAG = 0.15  # s
_LEAP = 0.5  # s: what is shown after a longer time, or before, is begun with anew
_CIRCLE, _CIRCLE_TRIANGLES = mesh.circle(20)
_QUAD = mesh.fan(4)

_WAIST = ("LFWT", "RFWT", "LBWT", "RBWT")
_TRAILS = ((_WAIST, VIOLET), (("LHEE", "LTOE"), CYAN), (("RHEE", "RTOE"), CYAN))


@dataclass(frozen=True, slots=True)
class Worn:
    """Which markers somebody wears: principal and reference ones, and those in whose middle the
    body frame has its origin.
    """

    principal: tuple[str, ...] = ()
    references: tuple[str, ...] = ()
    origin: tuple[str, ...] = ()

    @classmethod
    def of(cls, info: ModelInfo) -> Worn:
        """As a model says."""
        return cls(info.principal, info.references, CONSTRUCTIONS[info.body_frame].origin)

    @classmethod
    def among(cls, tracked: tuple[str, ...]) -> Worn:
        """As far as can be told from all that was worn."""
        for frame in (PAPER_FRAME, SIX_FRAME):
            if set(frame.references) <= set(tracked):
                rest = tuple(label for label in tracked if label not in frame.references)
                return cls(rest, frame.references, frame.origin)
        return cls(tracked)


class Scene:
    """A mesh, moved in place by `update`.

    info: the model's; its labels are the markers of a pose, in order. worn: what is shown as discs.
    error: RMS over all markers in mm, a little smoothed, None where the truth is not known.
    """

    def __init__(self, info: ModelInfo, worn: Worn) -> None:
        labels = info.labels
        ends = stick_rows(labels)
        self.error: float | None = None
        # A lone origin has no disc but the origin's.
        discs = [label for label in worn.principal + worn.references if (label,) != worn.origin]
        self._worn = [labels.index(label) for label in discs]
        self._worn_colours = np.array(
            [WHITE if label in worn.principal else PALE for label in discs]
        ).reshape(-1, 3)
        self._origin = [labels.index(label) for label in worn.origin]
        self._follow = Follow([labels.index(label) for label in REFERENCES])
        self._last: float | None = None
        self._followed = self._beside = False

        trail = (TRAIL_POINTS - 1, 4, _QUAD)
        disc = (len(discs) + bool(worn.origin), len(_CIRCLE), _CIRCLE_TRIANGLES)
        shadow = Body.shadow_shapes(len(ends))
        body = Body.shapes(len(labels), len(ends))
        # In drawing order.
        shapes = [(SQUARES, 4, _QUAD), shadow, shadow, *[trail] * len(_TRAILS), disc, disc]
        self.mesh = Mesh([*shapes, *body, *body])
        floor, *parts = self.mesh.parts
        shadows, trails, (self._rims, self._discs), true, estimate = (
            parts[:2], parts[2:5], parts[5:7], parts[7:10], parts[10:]
        )  # fmt: skip
        self._floor = Floor(floor)
        self._trails = [
            Trail(part, [labels.index(label) for label in of if label in labels], colour)
            for part, (of, colour) in zip(trails, _TRAILS, strict=True)
        ]
        for part in shadows:
            part.colours[:] = _SHADOW
        self._rims.colours[:] = BACKGROUND
        self._true = Body(ends, true, shadows[0])
        self._estimate = Body(ends, estimate, shadows[1])
        self._solvers = {body: HumanoidSolver(info) for body in (self._true, self._estimate)}

    def update(
        self,
        moment: Moment,
        trail: list[Moment],
        look: Look,
        camera: Camera,
        *,
        playing: bool = True,
    ) -> None:
        """Moves everything to a moment. trail: what was shown before it, the newest first. Where
        nothing is playing the error is told as it is.
        """
        pose, truth = moment
        step = math.inf if self._last is None else pose.t - self._last
        step = step if 0 <= step <= _LEAP else math.inf
        self._last = pose.t
        self._follow.turn_to(VIEWPOINTS[look.view].facing)
        if look.follow or step == math.inf:
            self._follow.update(pose.xyz, step if self._followed else math.inf)
        self._followed = look.follow
        # A true pose that is missing for a while does not make the other leap to the middle.
        self._beside = self._beside or truth is not None
        aside = camera.sideways * (APART if self._beside and not look.over else 0.0)
        sigma = pose.sigma if look.sigma else None
        kinds = Colours(_SPHERES[pose.provenance], _STICKS[pose.provenance])
        self._place(self._estimate, pose, sigma, kinds, aside, look, camera)
        known = truth if truth is not None else np.full_like(pose.xyz, np.nan)
        gold = np.broadcast_to(GOLD, known.shape)
        true_pose = replace(pose, xyz=known)
        self._place(self._true, true_pose, None, Colours(gold, gold), -aside, look, camera)
        self._floor.place(self._follow)
        went = np.array([before.pose.xyz for before in trail])
        ages = np.array([pose.t - before.pose.t for before in trail])
        for path in self._trails:
            path.place(went, ages, self._follow, aside, camera)
        self._place_discs(pose, camera)
        self._measure(moment, step if playing else math.inf)

    def _place(
        self,
        body: Body,
        pose: Pose,
        sigma: Floats | None,
        colours: Colours,
        aside: Array,
        look: Look,
        camera: Camera,
    ) -> None:
        follow = self._follow
        body.place(follow.to_rig(pose.xyz) + aside, sigma, colours, camera)
        posture = self._solvers[body].solve(pose) if look.bones else None
        if posture is None:
            body.join(colours, camera)
            return
        turn = np.eye(3)
        turn[:2, :2] = follow.rotation
        bones = Bones(
            follow.to_rig(posture.joints) + aside,
            turn @ matrices(posture.rotations.astype(float)),
            float(posture.rest[0, 2]),
        )
        body.join_bones(bones, colours.sticks.mean(axis=0), camera)

    def _place_discs(self, pose: Pose, camera: Camera) -> None:
        colours = np.where(
            (pose.provenance[self._worn] == Provenance.MEASURED)[:, None],
            self._worn_colours,
            _SPHERES[pose.provenance[self._worn]],
        )
        places, radii = self._estimate.places[self._worn], self._estimate.radii[self._worn]
        if self._origin:
            # The worst of what it is taken from; a lone one is where it is, and as large.
            kind = pose.provenance[self._origin].max()
            colour = GREEN if kind == Provenance.MEASURED else _SPHERES[kind]
            colours = np.concatenate([colours, [colour]])
            middle = self._estimate.places[self._origin].mean(axis=0)
            places = np.concatenate([places, [middle]])
            radii = np.append(radii, self._estimate.radii[self._origin].max())
        self._discs.colours[:] = colours[:, None]
        plane = _CIRCLE @ [camera.right, camera.up]
        lift = (radii[:, None] + _LIFT) * camera.back
        radii = np.maximum(_DISC, radii)[:, None, None]
        for part, rim, nearer in ((self._rims, _RIM, 0.0), (self._discs, 0.0, 0.004)):
            centres = places + lift + nearer * camera.back
            part.points[:] = or_nothing(centres[:, None] + (radii + rim) * plane)

    def _measure(self, moment: Moment, step: float) -> None:
        if moment.truth is None:
            self.error = None
            return
        error = rms_mm(moment.pose.xyz, moment.truth)
        error = 0.0 if math.isnan(error) else error
        before = error if self.error is None else self.error
        self.error = before + share(step, _ERROR_LAG) * (error - before)
