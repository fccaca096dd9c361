"""Relations and what they have: fields, groupings, subsets, members; and globals."""
