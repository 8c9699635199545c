"""The feature of principal components: values, bounds, identity, use in the wrapper."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from known_ropes import MODELS, WORKSPACE, N, fit, ropes, seen
from rope_env import run, wrapped

from shape_obs import schema_hash
from shape_obs.features import FeatureContext, PrincipalComponents
from shape_obs.geometry.topology import Chain


@pytest.fixture
def view(overhead) -> FeatureContext:
    return FeatureContext(320, 240, overhead, WORKSPACE)


@pytest.fixture
def file(tmp_path) -> str:
    fit().save(tmp_path / "rope.npz")
    return str(tmp_path / "rope.npz")


class TestFeature:
    @pytest.mark.parametrize("origin", [None, "centroid"])
    @pytest.mark.parametrize("aligned", [False, True])
    def test_values_and_bounds(self, tmp_path, view, overhead, origin, aligned):
        MODELS[origin, aligned].save(tmp_path / "a.npz")
        feature = PrincipalComponents(str(tmp_path / "a.npz"))
        low, high = feature.bounds(Chain(N), view)
        count = 6 + (0 if not aligned else 2 if origin else 5)
        units = feature.units(Chain(N), view)
        assert len(low) == len(high) == len(units) == count
        assert set(units) == ({"m", ""} if aligned else {"m"})
        assert feature.unit == ("" if aligned else "m")
        assert np.isfinite([low, high]).all()
        assert (low < high).all()
        assert feature.needs_depth
        assert feature.invertible
        assert not feature.anchored
        draw = np.random.default_rng(0)
        for points in (*ropes(20, seed=2, heading=3.0), *draw.uniform(*WORKSPACE, size=(20, N, 3))):
            values = feature.compute(seen(points, overhead), view)
            assert (values >= low).all()
            assert (values <= high).all()
        shape = seen(ropes(1, seed=2)[0], overhead, np.arange(N) != 7)
        assert feature.error(shape, view) < (1e-3 if aligned else 5e-3)
        back = feature.reconstruct(feature.compute(shape, view), Chain(N), view)
        assert back.shape == (N, 3)

    def test_the_schema_follows_the_content_not_the_place(self, file, tmp_path, monkeypatch):
        def hashed(path: Any) -> str:
            return schema_hash({"features": [{"kind": "pca", "file": str(path)}]})

        before = hashed(file)
        (tmp_path / "copy.npz").write_bytes(Path(file).read_bytes())
        monkeypatch.chdir(tmp_path)
        assert hashed("copy.npz") == before
        feature = PrincipalComponents(file)
        fit(ropes(100)).save(file)
        assert hashed(file) != before
        assert schema_hash({"features": [feature]}) == before, "it holds what it has read"
        assert [hashed(file), hashed(file)] == 2 * [hashed(file)]

    @pytest.mark.filterwarnings("error::UserWarning")
    @pytest.mark.parametrize("aligned", [False, True])
    def test_in_the_wrapper(self, tmp_path, aligned):
        fit(ropes(50), aligned=aligned).save(tmp_path / "a.npz")
        env = wrapped(
            features=[{"kind": "pca", "file": str(tmp_path / "a.npz")}, "ok"], workspace=((-1, -1, -1), (1, 1, 2))
        )
        for (observation, *_), expected in zip(run(env), run(copy.deepcopy(env)), strict=True):
            assert env.observation_space.contains(observation)
            np.testing.assert_array_equal(observation, expected[0])
        lost = wrapped(env=copy.deepcopy(env.unwrapped), features=[PrincipalComponents(str(tmp_path / "a.npz"))])
        lost.unwrapped.hide = [0]  # type: ignore[attr-defined]
        assert np.isfinite(lost.reset(seed=0)[0]).all()
