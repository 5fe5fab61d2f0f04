"""Models and a log of the demo, and a browser."""

import os
import shutil
from dataclasses import replace

import numpy as np
import pytest
from report_results import JOINT, LOG, URDF

from geodrake import load_model
from geodrake.effects import Contact, CoulombFriction, FittedEffect, GravityTilt, Payload
from geodrake.inertia import from_mass_com_inertia
from geodrake.logs import read_log
from geodrake.report.playback import play_back


@pytest.fixture(scope="session")
def before():
    return load_model(URDF)


@pytest.fixture(scope="session")
def after(before):
    payload = from_mass_com_inertia(2.5, np.array([0.0, 0.0, 0.1]), 0.01 * np.eye(3))
    force = np.array([0.0, 0.0, -5.0, 0.0, 0.0, 0.0])
    effects = (
        FittedEffect(Payload("flange"), payload),
        FittedEffect(CoulombFriction(JOINT), np.array([8.0])),
        FittedEffect(Contact("flange", 1.0, 2.0, x=0.1), force),
        FittedEffect(GravityTilt(), np.array([0.01, 0.0])),
    )
    return replace(before, effects=effects)


@pytest.fixture(scope="session")
def cut():
    """Return the first seconds of the log."""
    log, few = read_log(LOG), slice(None, 900)
    arrays = {name: getattr(log, name)[few] for name in ("time", "position", "effort", "velocity")}
    return replace(log, **arrays, acceleration=None)


@pytest.fixture(scope="session")
def short(before, after, cut):
    return play_back(after, [cut], before=before)


@pytest.fixture(scope="module")
def browser():
    """Start Chromium with playwright; skip tests where either is not installed."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    names = ("chromium", "chromium-browser", "google-chrome")
    path = os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, names)), None)
    if path is None:
        pytest.skip("no Chromium is installed")
    flags = ["--no-sandbox", "--disable-background-networking", "--use-angle=swiftshader"]
    with playwright.sync_playwright() as driver:
        started = driver.chromium.launch(
            executable_path=path, args=[*flags, "--enable-unsafe-swiftshader"]
        )
        yield started
        started.close()
