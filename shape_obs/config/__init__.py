"""What a detector is made of: its arguments as one spec, ``detector_config``, and as a YAML file, ``config_file``."""
