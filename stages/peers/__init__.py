"""Other people's ways from the same pictures to a novel view, drawn in the place of ours so that both can be measured
alike."""
