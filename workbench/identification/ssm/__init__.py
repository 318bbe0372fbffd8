"""Sparse set membership identification (SSM) of LPV models, one regression per output:

    y(k) = sum_{i=1..n} f_i(p(k-n)) y(k-i) + sum_{i=1..n} g_i(p(k-i)) u(k-i) + d(k),    ||d||_h <= mu      # [1] eq. (1.3)
    f_i = sum_j alpha_ij beta_j,  g_i likewise

which is Y = Psi theta + d with one column per (past signal, basis function). Step 1 finds the sparsest theta (in the l1
sense) that the bound allows, step 2 fits best on its support. With several outputs every regression contains the past
of all outputs and all inputs. Several records give rows of their own; no row reaches across a joint.

The model is the block observer form of the recursion, exact for schedules that move however fast:

    y(k) = x_1(k),   x_i(k+1) = x_{i+1}(k) + f_i(p(k+i-n)) y(k) + g_i(p(k)) u(k),   i = 1..n, x_{n+1} = 0

so f_i enters with delay n - i and g_i with none. Its one-step predictor is the same with y measured: F is the shift and
forgets its initial state after n samples.

[1] Sparse set membership identification of LPV systems and the web winding machine, sections 1.2 and 1.4.3.
"""

from workbench.identification.sparse import L2, LInf, NotSolvedError
from workbench.identification.ssm.options import SSM, FittedZero, Plain, RawSignals, ScheduledMean, UnitColumns
from workbench.identification.ssm.sweep import Candidate, SSMSweep

__all__ = [
    "L2",
    "SSM",
    "Candidate",
    "FittedZero",
    "LInf",
    "NotSolvedError",
    "Plain",
    "RawSignals",
    "SSMSweep",
    "ScheduledMean",
    "UnitColumns",
]
