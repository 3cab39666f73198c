"""Runs of the CRH380A as one mass for paper 003: some on 286 km, the others shorter with the same phases.

The largest errors of both occur in the same phases. The errors of the printed law also depend on the length of the run,
because its funnel narrows over hours.
"""

from train_ato.papers.claims import Case
from train_ato.papers.paper_runs import read_paper_runs

LAWS, TRAINS, SINGLE, PRINTED_FORMS = read_paper_runs(__package__)
CASES = SINGLE | {
    f"{key} {train}": Case(f"crh380a_funnel:short{variants}", changes)
    for key, (_, changes) in LAWS.items()
    for train, (_, variants) in TRAINS.items()
    if key != "quiet" or "planned" not in train
}
