"""What a picture shows: a film, its stage and the commands that meshcat draws it by."""
