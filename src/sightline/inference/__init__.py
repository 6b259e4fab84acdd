"""What users call: predictors over samples and jobs over data sets."""
