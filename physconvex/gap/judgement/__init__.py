"""From fits to an answer: probabilities, doses and intervals by name, rules, caveats, the next experiment."""
