from truestroke._kernel import HISTORY as HISTORY
from truestroke._kernel import MAX_CREEPS as MAX_CREEPS
from truestroke._kernel import MAX_DEAD_ZONES as MAX_DEAD_ZONES
from truestroke._kernel import MAX_DUHEM as MAX_DUHEM
from truestroke._kernel import MAX_PLAYS as MAX_PLAYS
from truestroke._kernel import REAL_BYTES as REAL_BYTES
from truestroke._kernel import Kernel as Kernel
from truestroke._kernel import Repetition as Repetition
