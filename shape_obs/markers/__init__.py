"""ArUco markers: found in images, laid on a table, and the table seen from above."""

from __future__ import annotations

from shape_obs.markers.finder import DICTIONARY as DICTIONARY
from shape_obs.markers.finder import Corners as Corners
from shape_obs.markers.finder import check_ids as check_ids
from shape_obs.markers.finder import dictionary_named as dictionary_named
from shape_obs.markers.finder import find_markers as find_markers
from shape_obs.markers.top_view import MarkerLayout as MarkerLayout
from shape_obs.markers.top_view import MarkersNotSeen as MarkersNotSeen
from shape_obs.markers.top_view import TopView as TopView
from shape_obs.markers.top_view import fourth_marker as fourth_marker
