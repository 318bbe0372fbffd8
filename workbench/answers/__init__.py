"""What the verbs of the front door answer: one file a verb, its sentences, its files and its page."""
