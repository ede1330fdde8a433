"""What a job asks for: a job file or keyword arguments come in, a list of tasks leaves."""
