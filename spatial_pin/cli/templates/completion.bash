# Completion of spatial-pin; in ~/.bashrc: eval "$(spatial-pin completion bash)"
_spatial_pin() {
    local current=${COMP_WORDS[COMP_CWORD]} before=${COMP_WORDS[COMP_CWORD-1]}
    local command=${COMP_WORDS[1]} words="" value="" kind=""
    COMPREPLY=()
    if ((COMP_CWORD == 1)); then
        words="@WORDS@ --help --version"
        COMPREPLY=($(compgen -W "$words" -- "$current"))
        return
    fi
    case "$command $before" in
@VALUES@
    esac
    if [[ -z $value && $current == -* ]]; then
        case "$command" in
@FLAGS@
        esac
        COMPREPLY=($(compgen -W "$words" -- "$current"))
        return
    fi
    [[ -n $value ]] || case "$COMP_CWORD $command" in
        @TAKING@)
            compopt -o filenames 2>/dev/null || true
            COMPREPLY=($(compgen -W "@MECHANISMS@" -- "$current") \
                       $(compgen -f -- "$current")) ;;
        "2 completion") COMPREPLY=($(compgen -W "@SHELLS@" -- "$current")) ;;
@PLACES@
    esac
    if [[ -n $kind && $current != "=" && $before != "=" ]]; then
        [[ $kind != *= ]] || compopt -o nospace 2>/dev/null || true
        words="$(spatial-pin @NAMES@ "$kind" "${COMP_WORDS[2]}" 2>/dev/null)"
    fi
    # without words: names of files, by -o default
    [[ -z $words ]] || COMPREPLY=($(compgen -W "$words" -- "$current"))
}
complete -o default -F _spatial_pin spatial-pin
