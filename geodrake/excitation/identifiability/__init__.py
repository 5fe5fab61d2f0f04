"""What is identifiable of a model from given logs.

    found = log_identifiability(load_model("arm.urdf"), ["log.csv"])
    print(f"{found.count} of {found.possible} directions are identifiable")

Logs are prepared and reduced as for every fit, so that what is counted are filtered samples of
independent noise. The noise is what the model, refitted, leaves on held-out data: whatever else is
in there, an estimate has to live with it.
"""

from geodrake.excitation.identifiability.logs import log_identifiability
from geodrake.excitation.identifiability.results import LogIdentifiability

__all__ = [
    "LogIdentifiability",
    "log_identifiability",
]
