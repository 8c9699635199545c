"""Extract shapes and features of many recorded episodes into a dataset. Needs the extra ``parquet``."""

from shape_obs.extraction.dataset import extract
from shape_obs.extraction.extraction import Extraction
from shape_obs.extraction.task import Outcome, Task, all_tasks, tasks_of

__all__ = ["Extraction", "Outcome", "Task", "all_tasks", "extract", "tasks_of"]
