"""Files and logs that people report trouble with."""
