"""What a track stores besides nodes: one record that Python and compiled code share, copied and pickled as a whole."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.tracking.model import ChainModel

State = npt.NDArray[Any]

_MOTION: Final = [
    ("stamp", "f8"),  # s, when the shape was seen
    ("interval", "f8"),  # s, over which its velocity was seen; 0 without one
    ("size", "f8"),  # of its form (arc length of a curve), hidden pieces included
    ("width", "f8"),  # of a rope, or of the largest piece of a mask, as it is believed; 0 in a cloud
    ("seen_width", "f8"),  # the same in the last frame alone
    ("box", "i8", 4),  # left, top, width and height of the rectangle around the mask; zeros without a mask
    ("box_motion", "i8"),  # pixels by which its edges have moved since the frame before, at most
]
#: An outline or a sheet.
ShapeState: Final = np.dtype(
    [
        *_MOTION,
        ("sides", "f8", 4),  # lengths of a sheet's sides, in the unit in which it is known
    ],
    align=True,
)
#: A rope. The first of two values is that of its start, the second that of its end.
RopeState: Final = np.dtype(
    [
        *_MOTION,
        ("area", "i8"),  # pixels or points of it; 0 if a part of it was hidden
        ("hidden", "f8", 2),  # share of its length that is out of sight
        ("occluded", "u1", 2),  # 1 if something is seen to hide the end
        ("folded", "u1", 2),  # 1 if the end is free, so that what is missing there was laid back onto the curve
        ("occlusion", "f8", 2),  # log-odds that the visible tip is cut by what hides the rest, and not the rope's own
        ("hold", "f8", 2),  # seconds for which the end is taken for hidden though nothing is seen to hide it
        ("drift", "f8"),  # share of its length by which it may have slid along itself while no end was seen
        ("tolerance", "f8"),  # share of its length: hidden ends with less are within the measuring error
        ("stretch", "f8"),  # how much more of it there is than was measured where it is visible
        ("measured", "f8"),  # its length when all of it was seen last, pixels or metres; 0 if it is not known
        ("shape_speed", "f8"),  # mean square of how fast its form leaves its prediction, beyond noise, (U/s)^2
        ("pose_speed", "f8"),  # the same of its points, in which place and form enter
        ("tips", "f8", (2, 2, 2)),  # mean and variance of what its own tips look like, by tip, see ``tip_shape``
        ("tips_known", "?"),  # whether they were seen
        ("pixels", "f8"),  # its length in the image; 0 if it is not known
        ("metres", "f8"),  # its length along the visible surface; 0 if it is not known
        ("pixels_spread", "f8"),  # share by which the length in pixels has varied, RMS: perspective and noise
        ("metres_spread", "f8"),  # the same of the length in metres: noise and oblique views
        ("frames", "f8"),  # in how many all of it was seen
        ("short", "f8"),  # seconds for which it was shorter than noise explains, though nothing hid it
        # What the last frame showed, besides the above.
        ("hides", "?"),  # whether an end is out of sight
        ("plain", "?"),  # whether no end is out of sight and no piece is bridged
        ("gap", "i8", 2),  # the last point of the curve before its widest bridged piece and the first after; or equal
        ("between", "f8"),  # by how much that piece is longer than it is bridged
        ("elsewhere", "f8"),  # share of its length that may be hidden elsewhere, see ``Placed``
        ("misplaced", "f8"),  # share of its curve that lies where a far part of it was predicted
        # By which share of its length other parts are hidden than before, or it is off; infinity if nothing fits.
        ("innovation", "f8"),
        ("unclear", "?"),  # whether its direction is not clear
        ("shown", "i8", 2),  # the points of its curve over which a shape's are spread: the first, the one past the last
        ("steep", "f8"),  # how much longer it is in space than in the image
        ("quality", "f8"),  # of the fit, 0...1
        ("refusal", "i8"),  # why its points may be wrong, see ``judge_chain``; 0 if they are not
        ("figures", "f8", 2),  # what was found and what is allowed, for its sentence
        ("follow", "?"),  # whether the track goes on with a curve that was refused
    ],
    align=True,
)
#: What is known of its length.
LENGTH: Final = ["pixels", "metres", "pixels_spread", "metres_spread", "frames", "short"]
#: What is known of its two ends.
ENDS: Final = ["hidden", "occluded", "folded", "occlusion", "hold"]


def new_rope(model: ChainModel, metres: float = 0.0) -> State:
    """Return the state ``(1,)`` of a new rope.

    Args:
        model: The constants.
        metres: Its length; 0 if it is not known.
    """
    state = np.zeros(1, RopeState)
    state["metres"], state["stretch"] = metres, 1.0
    state["pixels_spread"], state["metres_spread"] = model.first_spread
    return state
