"""Principal components: the model against scikit-learn and known shapes, its file, and the feature in the wrapper."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from known_ropes import EVERYWHERE, MODELS, WORKSPACE, N, fit, off, ropes, seen
from rope_env import run, wrapped

from shape_obs import schema_hash
from shape_obs.features import FeatureContext, PointDistribution, PrincipalComponents
from shape_obs.geometry.topology import Chain


@pytest.fixture
def file(tmp_path) -> str:
    fit().save(tmp_path / "rope.npz")
    return str(tmp_path / "rope.npz")


class TestModel:
    def test_whole_shapes_have_scikit_learns_coefficients(self):
        from sklearn.decomposition import PCA

        known, new = ropes(200), ropes(20, seed=1)
        pca = PCA(4, svd_solver="full").fit(known.reshape(200, -1))
        model = fit(known)
        for shape, expected in zip(new, pca.transform(new.reshape(20, -1)), strict=True):
            np.testing.assert_allclose(model.values(shape, EVERYWHERE), expected, atol=1e-9)
            np.testing.assert_allclose(model.values(shape, 0.02 * EVERYWHERE), expected, atol=1e-9)
            back = pca.inverse_transform(expected[None]).reshape(N, 3)
            np.testing.assert_allclose(model.points(expected), back, atol=1e-12)

    @given(st.integers(0, 10**6), st.sampled_from([None, "centroid"]), st.booleans())
    def test_a_fifth_of_the_points_is_not_missed(self, seed, origin, aligned):
        draw = np.random.default_rng(seed)
        model = MODELS[origin, aligned]
        whole = ropes(1, seed)[0] + draw.normal(scale=1e-4, size=(N, 3))
        weight = np.where(draw.permutation(N) < N // 5, 0.0, 1.0)
        points = np.where(weight[:, None] > 0, whole, np.nan)
        if origin:  # of what is seen
            points = points - np.nanmean(points, axis=0)
        back = model.points(model.values(points, weight))
        if origin:
            back = back - back.mean(axis=0) + whole.mean(axis=0)
        as_good_as = model.points(model.values(whole - whole.mean(axis=0) * bool(origin), EVERYWHERE))
        assert off(back, whole) < off(as_good_as, whole - whole.mean(axis=0) * bool(origin)) + 1.0

    def test_points_that_were_filled_in_hardly_count(self):
        model, whole = MODELS[None, False], ropes(1, seed=3)[0]
        wrong, weight = whole.copy(), EVERYWHERE.copy()
        wrong[[2, 9]] += 0.05
        weight[[2, 9]] = 0.02
        least = off(model.points(model.values(whole, EVERYWHERE)), whole)
        assert off(model.points(model.values(wrong, weight)), whole) < least + 1
        assert off(model.points(model.values(wrong, EVERYWHERE)), whole) > least + 5

    @pytest.mark.parametrize(
        ("points", "rest", "message"),
        [
            (ropes(9)[..., :2], {}, r"points \(F, 20, 3\) of Chain\(count=20\) in frame 'base', got \(9, 20, 2\)"),
            (np.full((9, N, 3), np.nan), {}, "unknown points among the shapes: leave those"),
            (ropes(9), {"components": 9}, "components: expected 1 to 8 for 9 shapes of 60 coordinates, got 9"),
            (np.tile(ropes(1), (9, 1, 1)), {}, "differ in 0 ways only"),
            (ropes(9) * np.eye(9)[0, :, None, None], {"aligned": True}, "too unlike the others"),
        ],
    )  # fmt: skip
    def test_what_cannot_be_fitted_raises_an_error(self, points, rest, message):
        with pytest.raises(ValueError, match=message):
            fit(points, **rest)


class TestFile:
    @pytest.mark.parametrize("aligned", [False, True])
    def test_it_comes_back_whole(self, tmp_path, aligned):
        model = fit(origin="centroid", aligned=aligned, about={"schema_hashes": ["abc"]})
        model.save(tmp_path / "a.npz")
        back = PointDistribution.load(tmp_path / "a.npz")
        for name in ("mean", "components", "variance", "noise"):
            np.testing.assert_array_equal(getattr(back, name), getattr(model, name))
        for name in ("layout", "frame", "origin", "aligned", "about", "unit"):
            assert getattr(back, name) == getattr(model, name)
        assert (back.about["shapes"], back.about["schema_hashes"]) == (200, ["abc"])
        back.save(tmp_path / "b.npz")
        assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()

    def test_a_damaged_file_or_another_one_raises_an_error(self, file, tmp_path):
        content, draw = Path(file).read_bytes(), np.random.default_rng(0)
        np.savez(tmp_path / "other.npz", mean=np.zeros(3))
        np.savez(tmp_path / "pickle.npz", metadata=np.array([{"a": 1}], dtype=object))  # never opened
        for at in (0, 10, 500, len(content) // 2, len(content) - 1, *draw.integers(0, len(content), 10)):
            (tmp_path / f"{at}.npz").write_bytes(content[:at])
        for path in tmp_path.glob("*.npz"):
            if path.name != "rope.npz":
                with pytest.raises(ValueError, match=f"{path.name}: not a file of principal components"):
                    PrincipalComponents(str(path))
        with pytest.raises(FileNotFoundError, match=r"d\.npz: no such file; `shape-obs fit-features -o .*d\.npz`"):
            PrincipalComponents(str(tmp_path / "d.npz"))
        with pytest.raises(ValueError, match=r"a\.txt: expected a file named \*\.npz"):
            fit().save(tmp_path / "a.txt")

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"variance": np.array([1.0, 0, 0, 0])}, "variances that are not positive"),
            ({"mean": np.full((N, 3), np.nan)}, "numbers that are not finite"),
            ({"components": np.zeros((4, N, 2))}, r"arrays of \(20, 3\) and \(4, 20, 2\) do not belong to Chain"),
        ],
    )
    def test_a_file_that_makes_no_sense_raises_an_error(self, file, change, message):
        with np.load(file) as arrays:
            content = {**arrays, **change}
        np.savez(file, **content)
        with pytest.raises(ValueError, match=message):
            PrincipalComponents(file)

    def test_it_is_for_one_frame_and_one_layout(self, file, overhead):
        with pytest.raises(ValueError, match="was fitted with frame 'base', but frame='camera' was requested: leave"):
            PrincipalComponents(Path(file), frame="camera")  # type: ignore[arg-type]
        with pytest.raises(ValueError, match=r"was fitted to shapes of Chain\(count=20\), but this one is Chain\(cou"):
            PrincipalComponents(file).bounds(Chain(9), FeatureContext(320, 240, overhead, WORKSPACE))
        with pytest.raises(ValueError, match=r"expected 4 values, got shape \(3,\)"):
            PointDistribution.load(file).points(np.zeros(3))


@pytest.fixture
def view(overhead) -> FeatureContext:
    return FeatureContext(320, 240, overhead, WORKSPACE)


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
