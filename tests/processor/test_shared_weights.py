"""A model's weights are in memory once, however many processors there are; a state may be kept without them."""

import copy
import pickle

import numpy as np
import pytest
from deciding import CONFIG, key
from held_memory import held_memory
from made import random_events, random_model, random_regressor_model

from async_tnt import Processor

EVENTS = random_events(400, seed=3, duration_us=5_000)
