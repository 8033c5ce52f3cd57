"""From fits to a verdict: probabilities, doses with intervals, rules, caveats, the next experiment."""
