"""What is handed over: numbers inside physics, whole friction laws, and the error of the files as written."""
