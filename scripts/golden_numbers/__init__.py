"""What `scripts/golden.py` computes and compares: answers and files of them, verbs, comparison.

To add a verb: a function of a freshly loaded mechanism in `verbs` that returns an `answer.Answer`,
and an entry in `verbs.VERBS`.
"""
