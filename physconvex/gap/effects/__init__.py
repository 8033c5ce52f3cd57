"""Named effects that a base model may lack, each with its doses and its place in the simulators."""
