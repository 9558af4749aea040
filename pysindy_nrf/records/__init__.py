"""Measured records: channels on one clock, files and bundled data."""

from ..common.lazy import public_names

_NAMES = {
    "BlockRows": "dataset",
    "Dataset": "dataset",
    "Extent": "extent",
    "FrequencyResponse": "files.frequency_response",
    "Input": "input_arrays",
    "KinematicSmoother": "fusion",
    "QualityNote": "quality",
    "Record": "record",
    "Segment": "dataset",
    "ZeroPhaseFilter": "zero_phase_filter",
    "channel_alignment": "checks.alignment",
    "channel_notes": "checks.channel_checks",
    "check_channels": "checks.channel_checks",
    "feature_names": "dataset",
    "filters_of": "zero_phase_filter",
    "from_arrays": "input_arrays",
    "fuse_record": "fusion.kinematics",
    "integrate": "fusion",
    "motion_notes": "checks.motion_checks",
    "to_features": "fusion.kinematics",
}
__all__ = [*_NAMES]

__getattr__, __dir__ = public_names(__name__, _NAMES)
