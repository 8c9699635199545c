"""How features answer to actions, learnt while moving: what all estimators of that have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class JacobianEstimator(ABC):
    """The matrix J (F,A) in ``delta_features = J delta_action``, from pairs of the two.

    What features are measured in does not matter to any of them, since all rows learn alike; actions are -1...1.

    Attributes:
        matrix: (F,A) J; None before ``start``.
        error: Share of the last change of features that was not foreseen, ``|df - J da| / |df|``; NaN before the first.
    """

    def __init__(self) -> None:
        self.matrix: Array | None = None
        self.error = float("nan")

    def start(self, features: int, actions: int, matrix: npt.ArrayLike | None = None) -> None:
        """Forget everything.

        Args:
            features: F.
            actions: A.
            matrix: (F,A) what is known already; zeros without.

        Raises:
            ValueError: A matrix of another size, or not finite.
        """
        begin = np.zeros((features, actions)) if matrix is None else np.array(matrix, dtype=np.float64)
        if begin.shape != (features, actions) or not np.all(np.isfinite(begin)):
            raise ValueError(f"expected a finite Jacobian ({features}, {actions}), got shape {begin.shape}.")
        self.matrix, self.error = begin, float("nan")
        self._begin(actions)

    def update(
        self,
        delta_features: npt.ArrayLike,
        delta_action: npt.ArrayLike,
        measured: npt.NDArray[np.bool_] | None = None,
    ) -> bool:
        """Learn from a change of features and the actions since: whether something was learnt.

        Args:
            delta_features: (F,).
            delta_action: (A,) the sum of the actions.
            measured: (F,) which features are learnt from; None for all.

        Nothing is learnt from changes that are not finite, nor without a motion.

        Raises:
            ValueError: ``start`` was not called, or a wrong size.
        """
        if self.matrix is None:
            raise ValueError("estimator: call start(features, actions) first.")
        df, da = np.asarray(delta_features, dtype=np.float64), np.asarray(delta_action, dtype=np.float64)
        if df.shape != self.matrix.shape[:1] or da.shape != self.matrix.shape[1:]:
            raise ValueError(
                f"estimator: expected changes of {self.matrix.shape[0]} features and {self.matrix.shape[1]} "
                f"actions, got {df.shape} and {da.shape}."
            )
        square = da @ da
        if not (np.isfinite(square) and square > 0 and np.all(np.isfinite(df))):
            return False
        residual = df - self.matrix @ da
        if measured is not None:
            residual = np.where(measured, residual, 0.0)
        self.error = float(np.linalg.norm(residual) / max(np.linalg.norm(df), 1e-12))
        self.matrix = self.matrix + np.outer(residual, self._gain(da))
        return True

    def _begin(self, actions: int) -> None:
        """Forget what else is known; most know nothing else."""
        return

    @abstractmethod
    def _gain(self, da: Array) -> Array:
        """(A,) how the residual of a motion is shared out among the columns: ``J += (df - J da) gain'``."""
