"""Choice of a clusterer, refused options, and clustering in a forked child."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass

import pytest

from shape_obs import Centerline, ShapeDetector, SpecError, load_config, save_config, schema_hash
from shape_obs.clustering.base import Centres, Clusterer, SelfOrganisingMap
from shape_obs.clustering.kmeans import KMeans
from tests.benchmarks.scores import score

NAMES = ("kmeans", "gmm", "fcm", "kohonen")


class TestConfiguration:
    def test_names_mappings_and_specs_say_the_same(self):
        said = ("kmeans", {"kind": "kmeans"}, KMeans())
        assert len({ShapeDetector(clustering=clustering).config for clustering in said}) == 1
        assert ShapeDetector().config.clustering == SelfOrganisingMap()
        assert ShapeDetector(clustering="som").config == ShapeDetector().config
        plain = ShapeDetector(clustering={"kind": "kmeans", "n_init": 3}).config.to_dict()
        assert json.loads(json.dumps(plain))["clustering"] == {"kind": "kmeans", "n_init": 3, "max_iter": 300}

    def test_it_belongs_to_the_schema_and_to_the_file(self, tmp_path):
        arguments = {"shapes": [{"kind": "contour"}], "clustering": "fcm"}
        save_config(tmp_path / "a.yaml", arguments)
        loaded = load_config(tmp_path / "a.yaml")
        assert loaded["clustering"]["kind"] == "fcm"
        assert schema_hash(loaded) == schema_hash(arguments)
        hashes = {schema_hash({**arguments, "clustering": name}) for name in ("som", *NAMES)}
        assert len(hashes) == 5
        assert schema_hash({"shapes": [{"kind": "contour"}]}) in hashes

    def test_unknown_names_get_a_hint(self):
        with pytest.raises(SpecError, match="unknown kind 'kmean'; did you mean 'kmeans'"):
            ShapeDetector(clustering="kmean")
        with pytest.raises(SpecError, match="kmeans: unknown field 'ninit'; did you mean 'n_init'"):
            ShapeDetector(clustering={"kind": "kmeans", "ninit": 3})

    @pytest.mark.parametrize(
        ("spec", "instead"),
        [
            ({"kind": "centerline", "ends": "tips"}, "ends='centers'"),
            ({"kind": "contour", "spacing": "m"}, "spacing='px'"),
        ],
    )
    def test_what_centres_cannot_give_is_refused(self, spec, instead):
        with pytest.raises(SpecError, match=f"needs clustering='som': 'kmeans' has its own centres; give {instead}"):
            ShapeDetector([spec], clustering="kmeans")

    @pytest.mark.parametrize(
        "wrong", [{"kind": "kmeans", "n_init": 0}, {"kind": "fcm", "tolerance": 0}, {"kind": "gmm", "max_iter": 0},
                  {"kind": "kohonen", "rate": 2.0}],
    )  # fmt: skip
    def test_settings_out_of_range_are_refused(self, wrong):
        with pytest.raises(ValueError, match=f"{wrong['kind']}: .*{[*wrong][1]}"):
            ShapeDetector(clustering=wrong)

    def test_a_clusterer_of_ones_own_works(self, wave):
        @dataclass(frozen=True)
        class EveryFifth(Clusterer):
            """Samples without preparation."""

            def centres(self, samples, layout, seed):
                return Centres(samples.points[:: len(samples) // layout.size][: layout.size], 1, True)

        shape = ShapeDetector([Centerline(n=5)], clustering=EveryFifth()).detect_mask(wave.mask).shapes[0]
        assert shape.ok
        assert score(shape.pixels, wave.curve, "centers").ordered


FORK = """
import os, sys
import numpy as np
from shape_obs.clustering.gmm import GaussianMixture
from shape_obs.clustering.kmeans import KMeans
from shape_obs.geometry.observed import Samples
from shape_obs.geometry.topology import Chain

points = np.random.default_rng(0).uniform(0, 100, (20000, 2))
samples = Samples(points, np.ones(len(points)), 1.0)
def run():
    return KMeans().centres(samples, Chain(20), 0).places.sum() + GaussianMixture(3).centres(samples, Chain(5), 0).steps
before = run()
child = os.fork()
if child == 0:
    os._exit(0 if run() == before else 3)
sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork")
def test_a_forked_child_can_cluster_too():
    environment = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    done = subprocess.run(
        [sys.executable, "-c", FORK], timeout=60, env={**environment, "OMP_NUM_THREADS": "2"}, capture_output=True
    )
    assert done.returncode == 0, done.stderr.decode()
