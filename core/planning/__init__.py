"""What a render spends its time on: how long passes take, how large their error is, and what follows for a budget or a target.

`machine` measures this machine once; `cost` predicts seconds; `planner` chooses method and numbers, and says why.
"""
