"""One gait at a time: solve a given mode sequence, simulate, verify."""

from gaitopt.study.claims import Verification as Verification
from gaitopt.study.return_map import return_map as return_map
from gaitopt.study.simulate import Walk as Walk
from gaitopt.study.simulate import simulate as simulate
from gaitopt.study.verify import verify as verify
