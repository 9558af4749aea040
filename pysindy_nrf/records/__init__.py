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
    "align": "checks.alignment",
    "channel_alignment": "checks.alignment",
    "channel_notes": "checks.channel_checks",
    "check_channels": "checks.channel_checks",
    "compare_channels": "checks.alignment",
    "data_warnings": "checks.channel_checks",
    "denoised": "fusion.noise_levels",
    "feature_names": "dataset",
    "fillers": "channels",
    "filters_of": "zero_phase_filter",
    "from_arrays": "input_arrays",
    "fuse_record": "fusion.kinematics",
    "integrate": "fusion",
    "levels_of": "fusion.noise_levels",
    "lowest_frequency": "zero_phase_filter",
    "motion_notes": "checks.motion_checks",
    "noisy_base": "fusion.noise_levels",
    "quiet_drive": "fusion.noise_levels",
    "quiet_level": "fusion.noise_levels",
    "resampled": "checks.alignment",
    "split_at_gaps": "checks.alignment",
    "to_features": "fusion.kinematics",
    "white_level": "fusion.noise_levels",
}
__all__ = [*_NAMES]

__getattr__, __dir__ = public_names(__name__, _NAMES)
