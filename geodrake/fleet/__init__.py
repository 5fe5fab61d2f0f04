"""Many logs of many robots: digests, which say in a small file what a log does."""

from geodrake.fleet.digest import Digest, DigestedLog, JointDigest, merge
from geodrake.fleet.digest_dataset import digest_dataset
from geodrake.fleet.digest_file import digest_content, read_digest
from geodrake.fleet.digest_folder import DigestRow, DigestRun, digest_files, digest_logs
from geodrake.fleet.making import LogFacts, Wanted, make_digest, make_settings
from geodrake.fleet.model_hash import model_hash
from geodrake.fleet.settings import (
    DigestColumn,
    DigestEffect,
    DigestSettings,
    read_settings,
)

__all__ = [
    "Digest",
    "DigestColumn",
    "DigestEffect",
    "DigestRow",
    "DigestRun",
    "DigestSettings",
    "DigestedLog",
    "JointDigest",
    "LogFacts",
    "Wanted",
    "digest_content",
    "digest_dataset",
    "digest_files",
    "digest_logs",
    "make_digest",
    "make_settings",
    "merge",
    "model_hash",
    "read_digest",
    "read_settings",
]
