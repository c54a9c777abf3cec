"""Events: streams of changes that their readers may see."""
