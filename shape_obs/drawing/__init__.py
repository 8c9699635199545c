"""Show detections to people: pictures with numbered points, and logs for the rerun viewer."""

from shape_obs.drawing.pictures import GOAL as GOAL
from shape_obs.drawing.pictures import HIDDEN as HIDDEN
from shape_obs.drawing.pictures import SLOTS as SLOTS
from shape_obs.drawing.pictures import VALID as VALID
from shape_obs.drawing.pictures import VISIBLE as VISIBLE
from shape_obs.drawing.pictures import Colour as Colour
from shape_obs.drawing.pictures import Image as Image
from shape_obs.drawing.pictures import draw_curve as draw_curve
from shape_obs.drawing.pictures import draw_detection as draw_detection
from shape_obs.drawing.pictures import draw_over as draw_over
from shape_obs.drawing.pictures import draw_point as draw_point
from shape_obs.drawing.pictures import draw_text as draw_text
from shape_obs.drawing.pictures import enlarged as enlarged
from shape_obs.drawing.pictures import legible_scale as legible_scale
from shape_obs.drawing.pictures import mark_size as mark_size
from shape_obs.drawing.pictures import point_colours as point_colours
from shape_obs.drawing.pictures import slot_colours as slot_colours
from shape_obs.drawing.pictures import text_width as text_width
from shape_obs.drawing.pictures import wrapped as wrapped
from shape_obs.drawing.rerun_log import RerunLog as RerunLog
from shape_obs.drawing.rerun_log import log_rerun as log_rerun
