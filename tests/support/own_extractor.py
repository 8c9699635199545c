"""A feature extractor of another package, for bundles that name it."""

from stable_baselines3.common.torch_layers import FlattenExtractor


class OwnExtractor(FlattenExtractor):
    """The same under another name."""
