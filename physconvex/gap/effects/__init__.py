"""Named effects that a base model may lack, with their doses and their implementation in the simulators."""
