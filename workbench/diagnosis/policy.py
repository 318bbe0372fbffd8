"""The thresholds of a diagnosis, in one place: from which evidence on something is said, and how surely."""

from workbench.diagnosis.screen import SIGNIFICANT

ALPHA = SIGNIFICANT  # family-wise, of the screen and of the remainder where nothing is named
LEFT_OVER = 1e-4  # the same, where something is named
WORTH = 6.0  # BIC by which a cause must be better
TIE, IDEAL = 10.0, 0.1  # BIC within which rivals are a tie; or share of a cause's gain, for laws of friction are idealised
SCATTER = 1.6  # standard deviations of the difference of two models between which it does not tell: 2 sqrt(TIE) of them are TIE
FAR_APART = 10.0  # times TIE from which on a gap is large whatever its scatter
ONE_STEP = 0.5  # share of a cause's gain that a law may be worse by at noise levels that suit the cause, and tie at its own
KNOWN = 0.05  # standard deviation of a size, in sizes of the named cause, below which records know it
UNSEEN = 0.9  # standard deviation of a number, in sizes of its effect or of its prior, from which on records do not show it
ASKED_FOR = 4.0  # deviance that one more number must take off: two standard deviations
BESIDE = 0.1  # share of what a cause gains from which on, left without a name, it is not sure
UNTOLD = 0.5  # share of what causes gain from which on, left without a name, they are none if their sizes differ between records
LOCAL = 20.0  # BIC from which a cause that does not hold everywhere is told
ALONE = 0.2  # share of what causes explain together, below which they are not sure where each of them left out leaves no more
LAWS = 0.05  # share of what causes gain up to which what is left may be the ideal form of their laws
WIDE = 0.1  # share of the largest speed over which a friction may turn its sign for sure and still be dry
PRACTICAL = 5e-4  # share of the squared errors below which an effect is of no practical size
LIKE_THE_FIRST = 0.03  # of the first cause's gain: less at the same place is the first one's form
SAME_CURVE = 0.1  # the same for effects over one and the same variable: torques over speed add up to one curve
NEARLY, FINALISTS = 0.1, 3  # share of the best refit's gain that a refit may miss and still be fitted to convergence, how many
ALIKE = 0.9  # share of a signature that another can mimic from which on both are fitted to convergence
RIVALS, SWAP = 4, 60.0  # of each cause, tried in its place beside the others; BIC that their first fit may lie behind
MOST = 3
FREED = 3  # times that what an effect gains may turn out to be a better fit of all else
MATTERS, MATTERS_ALONE = 0.01, 0.005  # share of an error that a further cause must take off; where nothing is left without a name
HARM = 0.1  # share of an error by which a cause may raise it and be sure
LONG_RUN = 0.2  # share of the error a second ahead that a search without coloured torques must take off to count
HELPFUL = 0.1  # the same for each of its causes
RETURNED, INSIDE = 50.0, 1.0  # deviance of parameters beyond their tolerance that an effect takes off, and what it may leave
LEAST = 0.01  # of nominal, below which a parameter is told whatever its tolerance
DIGITS = 1e-6  # relative, to which the values of a record tell a step
