"""From markers to a body: joints, bones and how they are turned, as engines want them."""
