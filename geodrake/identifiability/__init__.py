"""What given logs can tell of a model.

    found = log_identifiability(load_model("arm.urdf"), ["log.csv"])
    print(found.verdict())

Logs are prepared and reduced as for every fit, so that what is counted are filtered samples of
independent noise. The noise is what the model, refitted, leaves on held-out data: whatever else is
in there, an estimate has to live with it.
"""

from geodrake.identifiability.logs import log_identifiability
from geodrake.identifiability.results import LogIdentifiability, ToldBlock, ToldCombination

__all__ = ["LogIdentifiability", "ToldBlock", "ToldCombination", "log_identifiability"]
